#include "talker/head_decoder.h"

#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cmath>
#include <vector>

namespace freetalk::talker {
namespace {

/// A head of random weights, moved by three expressions.
head::ParametricHead small_head() {
  torch::manual_seed(3);
  head::HeadOptions options;
  options.global_dim = 6;
  options.local_dim = 4;
  options.identity_hidden = options.deformation_hidden = 64;
  options.anchor_hidden = options.identity_code_dim = 8;
  options.expression_dim = 5;
  options.deformation_layers = 4;
  options.direction = "both";
  options.num_weights = 3;
  options.expressions = {"jawOpen", "mouthSmile_L", "mouthSmile_R"};
  head::ParametricHead model(options);
  model->eval();
  return model;
}

rig::RigPoses poses() {
  rig::RigPoses result;
  result.names = {"jawOpen", "mouthSmileLeft", "mouthSmileRight"};
  torch::manual_seed(5);
  result.shapes = 5e-3 * at::randn({3, 68, 3});
  result.library = 5e-3 * at::randn({4, 68, 3});
  return result;
}

class HeadDecoderTest : public ::testing::Test {
 protected:
  HeadDecoderTest() {
    const torch::NoGradGuard no_grad;
    torch::manual_seed(7);
    z_id_ = 0.3 * at::randn({model_->identity_dim()});
    canonical_ = 0.1 * at::rand({40, 3}) - 0.05;
    share_ = at::linspace(0, 1, 40);
    decoder_ = std::make_unique<HeadDecoder>(head::PreparedHead(model_, z_id_), poses(), canonical_,
                                             share_);
  }

  head::ParametricHead model_ = small_head();
  at::Tensor z_id_, canonical_, share_;
  std::unique_ptr<HeadDecoder> decoder_;
};

TEST_F(HeadDecoderTest, WeightsFollowShapesByName) {
  head::HeadOptions options;
  options.num_weights = 5;
  options.expressions = {"browInnerUp_L", "browInnerUp_R", "jawOpen", "mouthSmile_L", "tongueOut"};
  const auto map =
      weights_of_shapes({"jawOpen", "browInnerUp", "mouthSmileLeft", "noseSneerLeft"}, options);
  const auto wanted = at::tensor({0, 0, 1, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0})
                          .view({4, 5})
                          .to(at::kFloat);
  EXPECT_TRUE(at::equal(map, wanted));
  options.expressions.clear();
  EXPECT_THROW(weights_of_shapes({"jawOpen"}, options), std::runtime_error);
}

TEST_F(HeadDecoderTest, IsTheHeadsDeformationByTheWeightsFound) {
  const torch::NoGradGuard no_grad;
  // Landmarks of a shape are explained by it alone, but for the solver's small costs.
  const auto moved = decoder_->decode(poses().shapes);
  const head::PreparedHead head(model_, z_id_);
  const auto points = 4 * canonical_;
  const auto rest = head.to_posed(points, model_->rest_expression);
  for (int64_t shape = 0; shape < 3; ++shape) {
    at::Tensor weights = at::zeros({1, 3});
    weights[0][shape] = 1;
    const auto code = model_->expression_code(weights)[0];
    const auto wanted = (head.to_posed(points, code) - rest) / 4 * share_.unsqueeze(1);
    const double off = (moved[shape] - wanted).norm().item<double>();
    EXPECT_GT(wanted.norm().item<double>(), 0);
    EXPECT_LT(off, 0.05 * wanted.norm().item<double>()) << shape;
  }
  EXPECT_EQ(moved.select(1, 0).abs().max().item<float>(), 0);  // of share 0
}

TEST_F(HeadDecoderTest, SpokenWeightsAreTakenByName) {
  const torch::NoGradGuard no_grad;
  facetalk::FaceTalkOptions options;
  options.codes = "weights";
  options.expressions = {"mouthSmile_R", "cheekPuff_L", "jawOpen"};
  const auto spoken = at::tensor({0.2F, 0.9F, 0.7F}).view({1, 3});
  const auto wanted = model_->expression_code(at::tensor({0.7F, 0.0F, 0.2F}).view({1, 3}));
  const at::Tensor still = at::zeros({1, 68, 3});
  EXPECT_TRUE(at::equal(decoder_->codes_of(spoken, options, still, still), wanted));
  options.codes = "head";
  const auto codes = model_->expression_code(at::tensor({0.1F, 0.2F, 0.3F}).view({1, 3}));
  EXPECT_TRUE(at::allclose(decoder_->codes_of(codes, options, still, still), codes, 0, 1e-6));
}

TEST_F(HeadDecoderTest, WhatLandmarksGainedIsAddedToSpokenWeightsWithinTheirRange) {
  const torch::NoGradGuard no_grad;
  facetalk::FaceTalkOptions options;
  options.codes = "weights";
  options.expressions = {"jawOpen"};
  const at::Tensor shape = poses().shapes.narrow(0, 0, 1);
  const auto code = [&](double weight) {
    return model_->expression_code(
        at::tensor({static_cast<float>(weight), 0.0F, 0.0F}).view({1, 3}));
  };
  const auto found = [&](double spoken, double before, double after) {
    return decoder_->codes_of(at::full({1, 1}, spoken), options, before * shape, after * shape);
  };
  const double unit = (code(1) - code(0)).norm().item<double>();
  // The solver's small costs leave a twentieth, as above.
  EXPECT_LT((found(0.3, 0.3, 0.6) - code(0.6)).norm().item<double>(), 0.05 * unit);
  EXPECT_LT((found(0.9, 0.2, 0.9) - code(1)).norm().item<double>(), 0.05 * unit);
  EXPECT_TRUE(at::equal(found(1.5, 0, 0), code(1)));
}

TEST_F(HeadDecoderTest, PlacesOfTheLandmarksFollowThem) {
  // A rough sheet of 21 x 21 vertices, 68 of them landmarks.
  constexpr int kSide = 21;
  Eigen::MatrixXd vertices(kSide * kSide, 3);
  Eigen::MatrixXi faces(2 * (kSide - 1) * (kSide - 1), 3);
  int face = 0;
  for (int v = 0; v < vertices.rows(); ++v) {
    const int row = v / kSide, column = v % kSide;
    vertices.row(v) << 0.005 * (column - 10), 0.005 * (row - 10), 0.002 * ((row + column) % 3);
    if (row + 1 == kSide || column + 1 == kSide) continue;
    faces.row(face++) << v, v + 1, v + kSide + 1;
    faces.row(face++) << v, v + kSide + 1, v + kSide;
  }
  std::vector<int> places(68);
  for (int n = 0; n < 68; ++n) places[static_cast<size_t>(n)] = 6 * n + 10;
  const auto follower = std::make_shared<const stm::LandmarkFollower>(
      vertices, faces, vertices(places, Eigen::all), Eigen::MatrixXd::Zero(68, 3));
  const at::Tensor canonical = 0.1 * at::rand({vertices.rows(), 3}) - 0.05;
  const head::PreparedHead head(model_, z_id_);
  const at::Tensor share = at::ones({vertices.rows()});
  const HeadDecoder plain(head, poses(), canonical, share);
  const HeadDecoder following(head, poses(), canonical, share, follower);
  // Smooth motion that the head's three expressions cannot explain.
  at::Tensor landmarks = at::empty({40, 68, 3});
  for (int n = 0; n < 68; ++n) {
    const double x = vertices(places[static_cast<size_t>(n)], 0);
    landmarks.select(1, n).copy_(at::linspace(0, 5e-3, 40).unsqueeze(1) * std::cos(20 * x));
  }
  const at::Tensor index = at::tensor(places, at::kLong);
  const auto off = [&](const HeadDecoder& decoder) {
    const at::Tensor there = decoder.decode(landmarks).index_select(1, index);
    return (there - landmarks).abs().mean().item<double>();
  };
  EXPECT_GT(off(plain), 1e-3);
  EXPECT_LT(off(following), 1e-4);
  EXPECT_LT(off(dynamic_cast<const HeadDecoder&>(following.fastest())), 1e-4);
  const at::Tensor codes = following.codes_of(landmarks);
  std::vector<at::Tensor> parts;
  following.decode_codes(codes, landmarks,
                         [&](int64_t, const at::Tensor& part) { parts.push_back(part); });
  EXPECT_TRUE(at::equal(at::cat(parts), following.decode(landmarks)));
}

TEST_F(HeadDecoderTest, AFrameDependsOnNoOther) {
  const auto landmarks = 3e-3 * at::randn({70, 68, 3});  // more than a chunk
  const auto all = decoder_->decode(landmarks);
  EXPECT_TRUE(at::equal(all.narrow(0, 60, 1), decoder_->decode(landmarks.narrow(0, 60, 1))));
  const auto coarse = decoder_->fastest().decode(landmarks);
  EXPECT_LT((coarse - all).abs().max().item<double>(), 1e-4);
}

}  // namespace
}  // namespace freetalk::talker
