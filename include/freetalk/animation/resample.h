// Motion at another frame rate.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>

namespace freetalk::animation {

/// Catmull-Rom interpolation in time, held beyond the ends. Frame t of either rate is at t / fps;
/// where times coincide, values are those of the source exactly.
/// @param motion (T, ...) floating point
/// @param num_frames of the result, >= 1
at::Tensor resample_motion(const at::Tensor& motion, double from_fps, double to_fps,
                           int64_t num_frames);

}  // namespace freetalk::animation
