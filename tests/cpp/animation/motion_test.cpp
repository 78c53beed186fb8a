#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "freetalk/animation/jaw.h"
#include "freetalk/animation/morph.h"
#include "freetalk/animation/resample.h"
#include "freetalk/core/conventions.h"
#include "scratch.h"

namespace freetalk::animation {
namespace {

at::Tensor low_rank_motion(int64_t frames, int64_t vertices, int64_t rank) {
  auto generator = at::detail::createCPUGenerator(5);
  const auto weights = at::randn({frames, rank}, generator);
  return weights.matmul(at::randn({rank, 3 * vertices}, generator)).view({frames, vertices, 3});
}

TEST(MorphBasis, FindsTheRankOfTheMotion) {
  // More columns than frames, and the other way round: both Gram matrices.
  for (const auto& [frames, vertices] : {std::pair{40, 100}, std::pair{90, 10}}) {
    const auto motion = low_rank_motion(frames, vertices, 6);
    const auto basis = morph_basis(motion, 1e-3, 64);
    EXPECT_EQ(basis.targets.size(0), 6 + 1);  // one more holds where the weights' ranges begin
    EXPECT_GE(basis.weights.min().item<double>(), 0.0);
    EXPECT_LE(basis.weights.max().item<double>(), 1.0);
    const auto rebuilt = basis.weights.matmul(basis.targets.flatten(1)).view({frames, vertices, 3});
    const double error = (rebuilt - motion).norm(2, -1).max().item<double>();
    EXPECT_LE(error, 1e-3);
    EXPECT_NEAR(basis.max_error, error, 1e-5);  // float32 rounding of values of order one
  }
}

TEST(MorphBasis, StopsAtTheToleranceOrTheLimit) {
  const auto motion = low_rank_motion(60, 200, 20);
  const double tolerance = 0.8 * motion.norm(2, -1).max().item<double>();
  const auto loose = morph_basis(motion, tolerance, 64);
  EXPECT_LT(loose.targets.size(0), 20);
  EXPECT_LE(loose.max_error, tolerance);
  const auto limited = morph_basis(motion, 1e-3, 5);
  EXPECT_EQ(limited.targets.size(0), 5);
  EXPECT_GT(limited.max_error, 1e-3);
}

TEST(MorphBasis, LongSequencesAreMeasuredOnAllFrames) {
  const auto motion = low_rank_motion(1200, 20, 4);
  EXPECT_LE(morph_basis(motion, 1e-3, 64).max_error, 1e-3);
}

TEST(Resample, SameRateIsTheIdentity) {
  const auto motion = low_rank_motion(31, 4, 3);
  EXPECT_TRUE(at::equal(resample_motion(motion, 30, 30, 31), motion));
}

TEST(Resample, KeepsCoincidingFramesAndLines) {
  const auto motion = low_rank_motion(31, 4, 3);
  const auto doubled = resample_motion(motion, 30, 60, 61);
  EXPECT_TRUE(at::equal(doubled.slice(0, 0, 61, 2), motion));
  const auto line = at::arange(0, 20, at::kDouble).view({20, 1});
  const auto resampled = resample_motion(line, 30, 25, 14);
  // Catmull-Rom reproduces straight lines away from the ends.
  const auto expected = at::arange(0, 14, at::kDouble).view({14, 1}) * 1.2;
  EXPECT_LT((resampled - expected).slice(0, 1, 13).abs().max().item<double>(), 1e-12);
}

TEST(Resample, HoldsTheLastFrame) {
  const auto motion = low_rank_motion(3, 4, 3);
  const auto longer = resample_motion(motion, 30, 30, 6);
  EXPECT_TRUE(at::equal(longer[5], motion[2]));
  EXPECT_EQ(resample_motion(motion.slice(0, 0, 1), 30, 50, 4).size(0), 4);
}

TEST(Resample, ShowsMomentsAtWhichLipsClose) {
  // Lips 8 mm apart that meet at frames 5, 11 and 18 of 24 in a second.
  at::Tensor landmarks = at::zeros({24, core::kNumLandmarks, 3}, at::kDouble);
  for (const auto& [upper, lower] : core::kInnerLips) landmarks.select(1, lower).fill_(-0.008);
  for (const int64_t frame : {5, 11, 18}) landmarks[frame].zero_();
  const auto smallest = [](const at::Tensor& motion, int64_t frame) {
    return (motion[frame][62][1] - motion[frame][66][1]).item<double>();
  };
  const auto usual = resample_motion(landmarks, 24, 30, 30);
  const auto shown = resample_motion(landmarks, 24, 30, 30, landmarks);
  for (const auto& [frame, nearest] : {std::pair{5, 6}, std::pair{11, 14}, std::pair{18, 23}}) {
    EXPECT_GT(smallest(usual, nearest), 1e-4) << frame;
    EXPECT_TRUE(at::equal(shown[nearest], landmarks[frame])) << frame;
  }
  // Elsewhere nothing changed, and motion that has no such moment is as ever.
  const std::vector<int64_t> moved{6, 14, 23};
  for (int64_t frame = 0; frame < 30; ++frame) {
    if (std::find(moved.begin(), moved.end(), frame) != moved.end()) continue;
    EXPECT_TRUE(at::equal(shown[frame], usual[frame])) << frame;
  }
  const auto still = at::zeros_like(landmarks), any = low_rank_motion(24, 4, 3);
  EXPECT_TRUE(at::equal(resample_motion(any, 24, 30, 30, still), resample_motion(any, 24, 30, 30)));
  EXPECT_THROW(resample_motion(any, 24, 30, 30, still.slice(0, 1)), std::invalid_argument);
}

TEST(Resample, FramesOfAClip) {
  EXPECT_EQ(core::num_frames(1.0, 30), 30);
  EXPECT_EQ(core::num_frames(0.001, 30), 1);
}

Eigen::MatrixXd chin_landmarks() {
  Eigen::MatrixXd landmarks = Eigen::MatrixXd::Zero(68, 3);
  for (int i = 0; i <= 16; ++i) {
    const double angle = M_PI * i / 16;
    landmarks.row(i) << -0.073 * std::cos(angle), 0.04 - 0.113 * std::sin(angle),
        -0.058 + 0.068 * std::sin(angle);
  }
  return landmarks;
}

TEST(Jaw, StaysWhenTheChinStays) {
  const auto motions = fit_jaw(chin_landmarks(), at::zeros({3, 68, 3}));
  ASSERT_EQ(motions.size(), 3u);
  for (const auto& motion : motions) {
    EXPECT_LT((motion.rotation - Eigen::Matrix3d::Identity()).norm(), 1e-9);
    EXPECT_LT(motion.translation.norm(), 1e-9);
  }
}

TEST(Jaw, OpensWhenTheChinDropsAndNeverBitesThrough) {
  auto drop = at::zeros({2, 68, 3});
  auto at_frame = drop.accessor<float, 3>();
  const double shares[] = {0.50, 0.69, 0.81, 0.83, 0.81, 0.69, 0.50};
  for (int i = 0; i < 7; ++i) {
    at_frame[0][5 + i][1] = static_cast<float>(-0.02 * shares[i]);
    at_frame[0][5 + i][2] = static_cast<float>(-0.02 * shares[i]);
    at_frame[1][5 + i][1] = 0.02f;
  }
  const auto motions = fit_jaw(chin_landmarks(), drop);
  const Eigen::Vector3d teeth(0, -0.04, 0.005);
  const Eigen::Vector3d opened = motions[0].rotation * teeth + motions[0].translation - teeth;
  EXPECT_LT(opened.y(), -0.01);
  const Eigen::Vector3d shut = motions[1].rotation * teeth + motions[1].translation - teeth;
  EXPECT_LT(shut.y(), 0.002);  // -1 degree at 9 cm
  // Rigid.
  EXPECT_LT(
      (motions[0].rotation.transpose() * motions[0].rotation - Eigen::Matrix3d::Identity()).norm(),
      1e-12);
}

}  // namespace
}  // namespace freetalk::animation
