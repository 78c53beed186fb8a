#include "nn/local_start.h"

#include <ATen/ATen.h>
#include <torch/utils.h>

#include <cmath>
#include <numbers>

namespace freetalk::nn {

namespace {

constexpr double kShortestPeriod = 3, kLongestPeriod = 150;  // frames
constexpr double kPeak = 6;  // of the logits; 1.5 frames away they are about 3

/// (F,) radians a frame, F = d_model / num_heads / 2, periods spaced geometrically.
at::Tensor rates(int64_t count) {
  return 2 * std::numbers::pi /
         at::logspace(std::log10(kShortestPeriod), std::log10(kLongestPeriod), count);
}

}  // namespace

at::Tensor local_position_code(int64_t num_frames, int64_t d_model, int64_t num_heads) {
  const int64_t count = d_model / num_heads / 2;
  const at::Tensor angles = at::arange(num_frames, at::kFloat).unsqueeze(1) * rates(count);
  return at::constant_pad_nd(at::cat({angles.cos(), angles.sin()}, 1), {0, d_model - 2 * count});
}

void start_locally(MultiheadAttention& attention, double radius) {
  const torch::NoGradGuard no_grad;
  const int64_t d = attention->in_proj_weight.size(1), heads = attention->num_heads();
  const int64_t width = d / heads, count = width / 2;
  const double gain =
      std::sqrt(kPeak * std::sqrt(static_cast<double>(width)) / static_cast<double>(count));
  for (int64_t head = 0; head < heads; ++head) {
    const double share = (2.0 * static_cast<double>(head) + 1) / static_cast<double>(heads) - 1;
    const at::Tensor turn =
        0.5 * radius * share * rates(count);  // from a frame to the one aimed at
    const at::Tensor cos = turn.cos().diag(), sin = turn.sin().diag();
    const at::Tensor turned = at::cat({at::cat({cos, -sin}, 1), at::cat({sin, cos}, 1)}, 0);
    const auto block = [&](int64_t first) {
      return attention->in_proj_weight.narrow(0, first + head * width, 2 * count)
          .narrow(1, 0, 2 * count);
    };
    block(0).copy_(gain * turned);
    block(d).copy_(gain * at::eye(2 * count));
  }
}

}  // namespace freetalk::nn
