// Lids close at intervals, unless the motion closes them itself.
#include "freetalk/talker/blinks.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <array>

namespace freetalk::talker {
namespace {

constexpr double kFps = 30.0;
constexpr std::array<int, 4> kUpper = {37, 38, 43, 44}, kLower = {41, 40, 47, 46};

/// Eyes that are 1 cm open; all else is at the origin.
Eigen::MatrixXd open_eyes() {
  Eigen::MatrixXd landmarks = Eigen::MatrixXd::Zero(68, 3);
  for (const int upper : kUpper) landmarks(upper, 1) = 0.01;
  return landmarks;
}

/// (T,) m, from lid to lid of one eye.
at::Tensor opening(const at::Tensor& motion) {
  return motion.select(1, kUpper[0]).select(1, 1) - motion.select(1, kLower[0]).select(1, 1) + 0.01;
}

int64_t count(const at::Tensor& opening) {
  const at::Tensor closed = opening.lt(0.005);
  return (closed.slice(0, 1) & ~closed.slice(0, 0, -1)).sum().item<int64_t>();
}

TEST(Blinks, AreAsManyAndAsLongAsTrackedOnes) {
  constexpr int64_t kMinutes = 30;
  at::Tensor motion = at::zeros({kMinutes * 1800, 68, 3});
  add_blinks(motion, open_eyes(), kFps, 3);
  const at::Tensor gap = opening(motion);
  // 12.1 a minute; of 363 waits a standard deviation of 4 %.
  EXPECT_NEAR(static_cast<double>(count(gap)) / kMinutes, 12.1, 1.5);
  // Half closed for 0.19 of their 0.38 s.
  EXPECT_NEAR(gap.lt(0.005).sum().item<double>() / kFps / static_cast<double>(count(gap)), 0.19,
              0.02);
  EXPECT_LT(gap.min().item<double>(), 0.002);
  EXPECT_GT(gap.min().item<double>(), 0.0);
  EXPECT_GT(gap.median().item<double>(), 0.0099);
  for (const int lower : kLower) EXPECT_EQ(motion.select(1, lower).abs().max().item<double>(), 0);
  EXPECT_EQ(motion.select(1, 62).abs().max().item<double>(), 0);
}

TEST(Blinks, KeepAwayFromThoseOfTheMotion) {
  at::Tensor motion = at::zeros({1800, 68, 3});
  for (int64_t t = 20; t < 1800; t += 80) {
    for (const int upper : kUpper) motion.slice(0, t, t + 4).select(1, upper).select(1, 1) -= 0.009;
  }
  const at::Tensor before = motion.clone();
  add_blinks(motion, open_eyes(), kFps, 3);
  EXPECT_TRUE(at::equal(motion, before));  // never 1.5 s from one
}

TEST(Blinks, FollowTheSeedAndTheLids) {
  const auto blink = [](uint64_t seed, double narrowed) {
    at::Tensor motion = at::zeros({900, 68, 3});
    for (const int upper : kUpper) motion.select(1, upper).select(1, 1) -= narrowed;
    add_blinks(motion, open_eyes(), kFps, seed);
    return motion;
  };
  EXPECT_TRUE(at::equal(blink(1, 0), blink(1, 0)));
  EXPECT_FALSE(at::equal(blink(1, 0), blink(2, 0)));
  EXPECT_GT(opening(blink(1, 0.006)).min().item<double>(), 0.0);  // half-closed lids do not cross
  at::Tensor none = at::zeros({0, 68, 3});
  EXPECT_NO_THROW(add_blinks(none, open_eyes(), kFps, 1));
}

}  // namespace
}  // namespace freetalk::talker
