#include "freetalk/animation/resample.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"

namespace freetalk::animation {
namespace {

constexpr double kClosedM = 0.001;  // gap beyond the neutral face's, as ats::articulate()

/// (T,) mean gap of the inner lips, m.
std::vector<double> lip_gaps(const at::Tensor& landmarks) {
  const at::Tensor height = landmarks.to(at::kCPU, at::kDouble).select(2, 1);
  at::Tensor gap = at::zeros({height.size(0)}, at::kDouble);
  for (const auto& [upper, lower] : core::kInnerLips) {
    gap += (height.select(1, upper) - height.select(1, lower)) / std::ssize(core::kInnerLips);
  }
  return {gap.const_data_ptr<double>(), gap.const_data_ptr<double>() + gap.numel()};
}

/// Moves the times (in frames of the source) of the frames that are nearest to brief closures.
void show_closures(std::vector<double>& times, const std::vector<double>& gaps, double per_frame) {
  const auto count = std::ssize(gaps);
  for (int64_t i = 1; i + 1 < count; ++i) {
    const double own = gaps[i], before = gaps[i - 1], after = gaps[i + 1];
    if (own > kClosedM || own > std::min(before, after) || std::max(before, after) <= kClosedM) {
      continue;
    }
    const auto nearest = std::llround(static_cast<double>(i) / per_frame);
    if (nearest < std::ssize(times)) times[nearest] = static_cast<double>(i);
  }
}

}  // namespace

at::Tensor resample_motion(const at::Tensor& motion, double from_fps, double to_fps,
                           int64_t num_frames, const at::Tensor& landmarks) {
  FREETALK_CHECK(motion.dim() >= 1 && motion.size(0) >= 1 && motion.is_floating_point(),
                 "resample_motion: motion must be (T, ...) floating point with T >= 1");
  FREETALK_CHECK(from_fps > 0 && to_fps > 0 && num_frames >= 1,
                 "resample_motion: rates and num_frames must be positive");
  FREETALK_CHECK(
      !landmarks.defined() || (landmarks.dim() == 3 && landmarks.size(0) == motion.size(0) &&
                               landmarks.size(1) == core::kNumLandmarks && landmarks.size(2) == 3 &&
                               landmarks.is_floating_point()),
      "resample_motion: expected landmarks (", motion.size(0), ", ", core::kNumLandmarks,
      ", 3) floating point, found ", landmarks.sizes());
  const int64_t last = motion.size(0) - 1;
  std::vector<double> times(num_frames);
  for (int64_t t = 0; t < num_frames; ++t) {
    times[t] = std::min(static_cast<double>(t) * from_fps / to_fps, static_cast<double>(last));
  }
  if (landmarks.defined()) show_closures(times, lip_gaps(landmarks), from_fps / to_fps);
  std::vector<int64_t> frames(4 * num_frames);
  std::vector<double> weights(4 * num_frames);
  for (int64_t t = 0; t < num_frames; ++t) {
    const double at = times[t];
    // Times that coincide up to rounding are taken as equal.
    const double near = std::round(at);
    const double position = std::abs(at - near) < 1e-9 ? near : at;
    const auto base = static_cast<int64_t>(std::floor(position));
    const double u = position - static_cast<double>(base);
    const double catmull_rom[4] = {0.5 * u * (u * (2 - u) - 1), 0.5 * (u * u * (3 * u - 5) + 2),
                                   0.5 * u * (u * (4 - 3 * u) + 1), 0.5 * u * u * (u - 1)};
    for (int64_t k = 0; k < 4; ++k) {
      frames[k * num_frames + t] = std::clamp<int64_t>(base + k - 1, 0, last);
      weights[k * num_frames + t] = catmull_rom[k];
    }
  }
  std::vector<int64_t> column(motion.dim(), 1);
  column[0] = num_frames;
  const auto index = at::tensor(frames, at::kLong).view({4, num_frames}).to(motion.device());
  const auto weight = at::tensor(weights, at::kDouble).view({4, num_frames}).to(motion.options());
  at::Tensor result;
  for (int64_t k = 0; k < 4; ++k) {
    const auto term = motion.index_select(0, index[k]) * weight[k].view(column);
    result = k == 0 ? term : result + term;
  }
  return result;
}

}  // namespace freetalk::animation
