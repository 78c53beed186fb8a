#include "freetalk/talker/blinks.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <vector>

namespace freetalk::talker {
namespace {

using Positions = at::TensorAccessor<float, 3>;

constexpr std::array<std::array<int, 2>, 4> kLids = {
    {{37, 41}, {38, 40}, {43, 47}, {44, 46}}};                    // upper, lower
constexpr double kClosing = 0.07, kShut = 0.04, kOpening = 0.13;  // s
constexpr double kClosure = 0.96;  // share of the way from lid to lid
constexpr double kClosed = 0.5;    // of the usual opening
constexpr double kApart = 1.5;     // s, from one blink to the next at least

/// Lid closure in [0, 1] at a time since the blink began.
double lid(double time) {
  const double left = kClosing + kShut + kOpening - time;
  const double share = std::clamp(std::min(time / kClosing, left / kOpening), 0.0, 1.0);
  return share * share * (3 - 2 * share);
}

std::vector<double> blink_times(double duration_s, uint64_t seed) {
  // Raw bits, not std::uniform_real_distribution: the same on every platform.
  std::mt19937_64 random(seed);
  const auto uniform = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
  std::vector<double> times;
  for (double at = 0.6 + 2 * uniform(); at < duration_s; at += 2.5 + 3.5 * uniform()) {
    times.push_back(at);
  }
  return times;
}

/// Seconds at which the motion itself has the eyes closed.
std::vector<double> closed_times(const Positions& motion, const Eigen::MatrixXd& landmarks,
                                 double fps) {
  std::vector<double> opening(motion.size(0), 0.0);
  for (size_t t = 0; t < opening.size(); ++t) {
    const auto frame = motion[static_cast<int64_t>(t)];
    for (const auto& [upper, lower] : kLids) {
      opening[t] += landmarks(upper, 1) + frame[upper][1] - landmarks(lower, 1) - frame[lower][1];
    }
  }
  std::vector<double> sorted = opening;
  const auto middle = sorted.begin() + static_cast<int64_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  std::vector<double> times;
  for (size_t t = 0; t < opening.size(); ++t) {
    if (opening[t] < kClosed * *middle) times.push_back(static_cast<double>(t) / fps);
  }
  return times;
}

}  // namespace

void add_blinks(at::Tensor& motion, const Eigen::MatrixXd& landmarks, double fps, uint64_t seed) {
  auto frames = motion.accessor<float, 3>();
  const std::vector<double> own = closed_times(frames, landmarks, fps);
  for (const double blink : blink_times(static_cast<double>(frames.size(0)) / fps, seed)) {
    const auto near = [&](double time) { return std::abs(time - blink) < kApart; };
    if (std::any_of(own.begin(), own.end(), near)) continue;
    const auto first = static_cast<int64_t>(std::ceil(blink * fps));
    for (int64_t t = first; t < frames.size(0); ++t) {
      const double time = static_cast<double>(t) / fps - blink;
      if (time > kClosing + kShut + kOpening) break;
      const double closure = kClosure * lid(time);
      for (const auto& [upper, lower] : kLids) {
        for (int axis = 0; axis < 3; ++axis) {
          const double gap = landmarks(lower, axis) + frames[t][lower][axis] -
                             landmarks(upper, axis) - frames[t][upper][axis];
          frames[t][upper][axis] += static_cast<float>(closure * gap);
        }
      }
    }
  }
}

}  // namespace freetalk::talker
