#include "freetalk/stm/adaptive_decoder.h"
#include "freetalk/stm/frame_decoder.h"

#include <ATen/Parallel.h>
#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cmath>
#include <memory>

#include "freetalk/core/random.h"
#include "freetalk/geometry/operators.h"

namespace freetalk::stm {
namespace {

/// A bent sheet of 9 x 8 vertices under a small STM that moves.
class AdaptiveDecoder : public testing::Test {
 protected:
  AdaptiveDecoder() {
    torch::manual_seed(0);
    StmOptions options;
    options.encoder_width = options.decoder_width = options.feature_dim = 16;
    options.encoder_blocks = options.decoder_blocks = 2;
    options.gcn_hidden = options.index_code_dim = options.attention_dim = 16;
    options.attention_heads = 2;
    options.k_eig = 12;
    model_ = Stm(options);
    const torch::NoGradGuard no_grad;
    model_->named_parameters()["decoder.last_lin.weight"].normal_(0, 0.3);
    model_->eval();
    Eigen::MatrixXd& vertices = vertices_;
    Eigen::MatrixXi& faces = faces_;
    int face = 0;
    for (int i = 0; i < 9; ++i) {
      for (int j = 0; j < 8; ++j) {
        const int v = 8 * i + j;
        vertices.row(v) << 0.08 * std::sin(0.3 * (j - 3.5)), 0.02 * (i - 4),
            0.08 * std::cos(0.3 * (j - 3.5));
        if (i == 8 || j == 7) continue;
        faces.row(face++) << v, v + 1, v + 8;
        faces.row(face++) << v + 1, v + 9, v + 8;
      }
    }
    geometry::OperatorOptions of_operators;
    of_operators.k_eig = options.k_eig;
    operators_ = geometry::surface_operators(vertices / options.length_scale, faces, of_operators)
                     .to(torch::kFloat);
    at::Tensor positions = torch::empty({72, 3});
    for (int v = 0; v < 72; ++v) {
      for (int c = 0; c < 3; ++c) positions[v][c] = vertices(v, c);
    }
    features_ = model_->encode(positions, operators_);
  }

  /// One that follows landmarks at the first vertices.
  FrameDecoder following() const {
    const Eigen::MatrixXd landmarks = vertices_.topRows(68);
    const auto follower = std::make_shared<const LandmarkFollower>(
        vertices_, faces_, landmarks, Eigen::MatrixXd::Zero(68, 3), FollowOptions{});
    return {model_.ptr(), features_, operators_, {}, follower};
  }

  FrameDecoder decoder(int64_t memory_bytes = int64_t{256} << 20) const {
    return {model_.ptr(), features_, operators_, {"float32", memory_bytes}};
  }

  /// Two smooth modes of a millimetre, each with its own rhythm, at 30 frames a second.
  static at::Tensor speech_like(int64_t frames) {
    const at::Tensor modes = 0.001 * torch::randn({2, 68, 3}, core::make_generator(4));
    const at::Tensor time = torch::arange(frames) / 30.0;
    const at::Tensor rhythm = torch::stack({torch::sin(7 * time), torch::sin(11.3 * time)}, 1);
    return torch::einsum("tm,mlc->tlc", {rhythm, modes}).contiguous();
  }

  Eigen::MatrixXd vertices_{72, 3};
  Eigen::MatrixXi faces_{112, 3};
  Stm model_{nullptr};
  geometry::SurfaceOperators operators_;
  MeshFeatures features_;
};

TEST_F(AdaptiveDecoder, StaysWithinTheTolerances) {
  const FrameDecoder exact = decoder();
  const at::Tensor landmarks = speech_like(240), every = exact.decode(landmarks);
  AdaptiveReport report;
  const AdaptiveOptions options{1.0, 0.02};  // A network of random weights is rougher than STM.
  const at::Tensor few = decode_adaptively(exact, landmarks, options, &report);
  EXPECT_EQ(report.frames, 240);
  EXPECT_LT(report.decoded, 200);
  const at::Tensor error = (few - every).norm(2, -1);
  EXPECT_LE(error.mean().item<double>(),
            options.tolerance_mean * every.norm(2, -1).mean().item<double>());
  EXPECT_LE(1e3 * error.max().item<double>(), options.tolerance_mm);
  EXPECT_LE(report.mean_error, options.tolerance_mean);
  EXPECT_LE(report.max_error_mm, options.tolerance_mm);
}

TEST_F(AdaptiveDecoder, AddedDifferencesAreFollowedAsLandmarksAre) {
  const at::Tensor zero = torch::zeros({20, 72, 3}), told = speech_like(20);
  const FrameDecoder decoder = following();
  const LandmarkFollower& follower = *decoder.follower();
  const at::Tensor more = 1e-3 * torch::randn({20, 68, 3}, core::make_generator(5));
  const at::Tensor moved = follower.apply(zero, told);
  follower.add(moved, more);
  EXPECT_TRUE(at::allclose(moved, follower.apply(zero, told + more), 1e-4, 1e-7));
}

TEST_F(AdaptiveDecoder, NoToleranceDecodesEveryFrame) {
  const FrameDecoder exact = decoder();
  const at::Tensor landmarks = speech_like(60);
  AdaptiveReport report;
  EXPECT_TRUE(at::equal(decode_adaptively(exact, landmarks, {0.0, 0.005}, &report),
                        exact.decode(landmarks)));
  EXPECT_EQ(report.decoded, 60);
}

TEST_F(AdaptiveDecoder, HasTheSameBitsForAnyThreadsAndMemory) {
  const at::Tensor landmarks = speech_like(90);
  const int threads = at::get_num_threads();
  at::set_num_threads(1);
  const at::Tensor one = decode_adaptively(decoder(), landmarks);
  const at::Tensor small = decode_adaptively(decoder(1), landmarks);
  const at::Tensor followed = decode_adaptively(following(), landmarks);
  at::set_num_threads(3);
  const at::Tensor three = decode_adaptively(decoder(), landmarks);
  const at::Tensor followed_by_three = decode_adaptively(following(), landmarks);
  at::set_num_threads(threads);
  EXPECT_TRUE(at::equal(one, small));
  EXPECT_TRUE(at::equal(one, three));
  EXPECT_TRUE(at::equal(followed, followed_by_three));
}

TEST_F(AdaptiveDecoder, ALongClipOfTheSameMotionDecodesHardlyMoreFrames) {
  const FrameDecoder exact = decoder();
  AdaptiveReport few, many;
  const at::Tensor once = speech_like(150);
  decode_adaptively(exact, once, {}, &few);
  decode_adaptively(exact, at::cat({once, once, once, once, once, once}), {}, &many);
  EXPECT_EQ(many.frames, 900);
  // Repeated frames raise no doubt; the batches of the checks may fall differently.
  EXPECT_LE(many.decoded, few.decoded + 16);
}

TEST_F(AdaptiveDecoder, AFaceAtRestIsDecodedOnce) {
  const FrameDecoder exact = decoder();
  AdaptiveReport report;
  const at::Tensor result = decode_adaptively(exact, at::zeros({100, 68, 3}), {}, &report);
  EXPECT_EQ(report.decoded, 1);
  EXPECT_TRUE(at::equal(result[0], result[99]));
  EXPECT_TRUE(at::equal(result[0], exact.fastest().decode(at::zeros({1, 68, 3}))[0]));
}

TEST_F(AdaptiveDecoder, ToleranceBelowTheRoundingDecodesExactly) {
  const FrameDecoder exact = decoder();
  const at::Tensor landmarks = speech_like(60);
  AdaptiveReport report;
  EXPECT_TRUE(at::equal(decode_adaptively(exact, landmarks, {1e-4, 1e-6}, &report),
                        exact.decode(landmarks)));
  EXPECT_EQ(report.decoded, 60);
}

TEST_F(AdaptiveDecoder, RefusesWhatDoesNotFit) {
  const FrameDecoder exact = decoder();
  EXPECT_THROW(decode_adaptively(exact, at::zeros({4, 3, 68})), std::invalid_argument);
  EXPECT_THROW(decode_adaptively(exact, at::zeros({4, 68, 3}), {-1.0, 0.005}),
               std::invalid_argument);
  EXPECT_THROW(decode_adaptively(exact, at::zeros({4, 68, 3}), {0.2, 0.0}), std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::stm
