#include "freetalk/animation/resample.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "freetalk/core/error.h"

namespace freetalk::animation {

at::Tensor resample_motion(const at::Tensor& motion, double from_fps, double to_fps,
                           int64_t num_frames) {
  FREETALK_CHECK(motion.dim() >= 1 && motion.size(0) >= 1 && motion.is_floating_point(),
                 "resample_motion: motion must be (T, ...) floating point with T >= 1");
  FREETALK_CHECK(from_fps > 0 && to_fps > 0 && num_frames >= 1,
                 "resample_motion: rates and num_frames must be positive");
  const int64_t last = motion.size(0) - 1;
  std::vector<int64_t> frames(4 * num_frames);
  std::vector<double> weights(4 * num_frames);
  for (int64_t t = 0; t < num_frames; ++t) {
    const double at =
        std::min(static_cast<double>(t) * from_fps / to_fps, static_cast<double>(last));
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
