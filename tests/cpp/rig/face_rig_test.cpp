#include "freetalk/rig/face_rig.h"

#include <ATen/Parallel.h>
#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cmath>
#include <filesystem>

#include "core/file.h"
#include "freetalk/core/log.h"
#include "freetalk/core/random.h"

namespace freetalk::rig {
namespace {

constexpr int64_t kVertices = 500;

at::Tensor random(std::vector<int64_t> sizes, uint64_t seed) {
  return torch::randn(sizes, core::make_generator(seed));
}

/// A smooth, slightly bent function of the landmarks, of the size of a face's motion.
at::Tensor decode(const at::Tensor& landmarks) {
  static const at::Tensor linear = random({204, 3 * kVertices}, 1) / 14.0;
  static const at::Tensor bend = random({204, 3}, 2) / 14.0;
  static const at::Tensor fields = 0.05 * random({3, 3 * kVertices}, 3);
  const at::Tensor flat = landmarks.flatten(1);
  return (flat.matmul(linear) + 1e2 * flat.matmul(bend).square().matmul(fields))
      .view({-1, kVertices, 3});
}

at::Tensor shapes() { return 0.004 * random({6, 68, 3}, 4); }

/// Mixtures of the shapes and of five modes that no shape has.
at::Tensor motion(int64_t frames, uint64_t seed) {
  const at::Tensor weights = torch::rand({frames, 6}, core::make_generator(seed));
  const at::Tensor others = 0.0006 * random({5, 68, 3}, 6);
  return torch::einsum("pw,wlc->plc", {weights, shapes()}) +
         torch::einsum("pw,wlc->plc", {random({frames, 5}, seed + 1), others});
}

RigPoses poses_of(int64_t count) {
  return {{"jawOpen", "mouthSmileLeft", "mouthSmileRight", "eyeWideLeft", "jawLeft", "jawRight"},
          shapes(),
          motion(count, 20)};
}

const FaceRig& rig() {
  static const FaceRig made = FaceRig::build(decode, poses_of(60));
  return made;
}

TEST(FaceRig, WeightsLieBetweenZeroAndOneWhateverTheLandmarks) {
  for (const double scale : {0.0, 1.0, 30.0}) {  // rest, speech, landmarks of no face
    const at::Tensor weights = rig().solve(scale * motion(20, 7));
    EXPECT_GE(weights.min().item<float>(), 0.0F);
    EXPECT_LE(weights.max().item<float>(), 1.0F);
  }
}

TEST(FaceRig, DecodedPosesComeBack) {
  const RigPoses poses = poses_of(60);
  const at::Tensor exact = decode(poses.library);
  const at::Tensor error = (rig().vertices(rig().solve(poses.library)) - exact).norm(2, -1);
  // What the correctives leave of the poses, plus rounding.
  EXPECT_LE(1e3 * error.square().mean().sqrt().item<double>(), 2 * rig().options().tolerance_mm);
}

TEST(FaceRig, CorrectivesBringUnseenMotionCloser) {
  RigOptions plain;
  plain.max_correctives = 0;
  const FaceRig shapes_alone = FaceRig::build(decode, poses_of(60), plain);
  const at::Tensor landmarks = motion(40, 9), exact = decode(landmarks);
  const auto error = [&](const FaceRig& one) {
    return (one.vertices(one.solve(landmarks)) - exact).norm(2, -1).mean().item<double>();
  };
  EXPECT_EQ(shapes_alone.names().size(), 6U);
  EXPECT_LT(error(rig()), 0.25 * error(shapes_alone));
}

TEST(FaceRig, AStreamWeighsAsTheWhole) {
  RigOptions slow;
  slow.temporal = 50.0;  // So that a frame depends on the one before.
  const FaceRig one = FaceRig::build(decode, poses_of(20), slow);
  const at::Tensor landmarks = motion(17, 11), whole = one.solve(landmarks);
  for (const int64_t chunk : {1, 5}) {
    SolveState state;
    std::vector<at::Tensor> parts;
    for (const at::Tensor& part : landmarks.split(chunk)) parts.push_back(one.solve(part, &state));
    EXPECT_TRUE(at::equal(at::cat(parts), whole));
  }
}

TEST(FaceRig, HasTheSameBitsForAnyNumberOfThreads) {
  const int threads = at::get_num_threads();
  const at::Tensor landmarks = motion(30, 13);
  const auto serial = [](const at::Tensor& poses) {  // torch's own products may differ
    const int wanted = at::get_num_threads();
    at::set_num_threads(1);
    const at::Tensor result = decode(poses);
    at::set_num_threads(wanted);
    return result;
  };
  std::vector<at::Tensor> results;
  for (const int count : {1, 3}) {
    at::set_num_threads(count);
    const FaceRig one = FaceRig::build(serial, poses_of(30));
    results.push_back(one.vertices(one.solve(landmarks)));
  }
  at::set_num_threads(threads);
  EXPECT_TRUE(at::equal(results[0], results[1]));
}

TEST(FaceRig, DisabledShapesStayAtZero) {
  RigOptions options;
  options.disabled = {"jawOpen"};
  const FaceRig one = FaceRig::build(decode, poses_of(20), options);
  EXPECT_EQ(one.solve(motion(10, 15)).select(1, 0).max().item<float>(), 0.0F);
}

TEST(FaceRig, ComesBackFromItsFile) {
  const auto folder = std::filesystem::path(testing::TempDir()) / "face_rig_test";
  rig().save(folder / "rig.safetensors");
  const FaceRig read = FaceRig::load(folder / "rig.safetensors");
  EXPECT_EQ(read.names(), rig().names());
  const at::Tensor landmarks = motion(5, 17);
  EXPECT_TRUE(
      at::equal(read.vertices(read.solve(landmarks)), rig().vertices(rig().solve(landmarks))));
  std::filesystem::remove_all(folder);
}

TEST(FaceRig, IsMadeOnceForTheSameContent) {
  const auto folder = std::filesystem::path(testing::TempDir()) / "face_rig_cache_test";
  std::filesystem::remove_all(folder);
  int64_t decoded = 0;
  const auto counting = [&decoded](const at::Tensor& landmarks) {
    decoded += landmarks.size(0);
    return decode(landmarks);
  };
  const FaceRig first = FaceRig::cached("a mesh", folder, counting, poses_of(10));
  const int64_t once = decoded;
  const FaceRig second = FaceRig::cached("a mesh", folder, counting, poses_of(10));
  EXPECT_EQ(decoded, once);
  EXPECT_TRUE(at::equal(first.targets(), second.targets()));
  FaceRig::cached("another mesh", folder, counting, poses_of(10));
  EXPECT_EQ(decoded, 2 * once);
  std::filesystem::remove_all(folder);
}

TEST(FaceRig, TellsOfACacheThatIsOfNoUse) {
  const auto folder = std::filesystem::path(testing::TempDir()) / "face_rig_broken_test";
  std::filesystem::remove_all(folder);
  std::vector<std::string> told;
  core::set_log_sink([&](core::LogLevel level, const std::string& text) {
    if (level == core::LogLevel::kWarning) told.push_back(text);
  });
  const FaceRig made = FaceRig::cached("a mesh", folder, decode, poses_of(5));
  EXPECT_TRUE(told.empty());
  for (const auto& file : std::filesystem::directory_iterator(folder / "operators")) {
    core::write_file_atomic(file.path(), std::string("broken"));
  }
  const FaceRig again = FaceRig::cached("a mesh", folder, decode, poses_of(5));
  EXPECT_TRUE(at::equal(again.targets(), made.targets()));
  ASSERT_EQ(told.size(), 1U);
  EXPECT_NE(told[0].find("made again"), std::string::npos);
  core::write_file_atomic(folder / "file", std::string("no folder"));
  FaceRig::cached("a mesh", folder / "file", decode, poses_of(5));
  core::set_log_sink({});
  ASSERT_EQ(told.size(), 2U);
  EXPECT_NE(told[1].find("not kept"), std::string::npos);
  std::filesystem::remove_all(folder);
}

TEST(FaceRig, RefusesWhatDoesNotFit) {
  RigPoses poses = poses_of(5);
  poses.names.pop_back();
  EXPECT_THROW(FaceRig::build(decode, poses), std::invalid_argument);
  RigOptions options;
  options.l2 = 0.0;
  EXPECT_THROW(FaceRig::build(decode, poses_of(5), options), std::invalid_argument);
  EXPECT_THROW(FaceRig::build([](const at::Tensor& l) { return decode(l) * NAN; }, poses_of(5)),
               std::runtime_error);
  EXPECT_THROW(rig().solve(at::zeros({2, 3, 68})), std::invalid_argument);
  EXPECT_THROW(rig().vertices(at::zeros({2, 3})), std::invalid_argument);
  // Without data: torch's own error, as the documented type.
  EXPECT_THROW(rig().solve(at::zeros({2, 68, 3}, at::kMeta)), std::runtime_error);
  SolveState other{{0.5}};
  EXPECT_THROW(rig().solve(motion(1, 1), &other), std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::rig
