// Motion at another frame rate.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>

namespace freetalk::animation {

/// Catmull-Rom interpolation in time, held beyond the ends. Frame t of either rate is at t / fps;
/// where times coincide, values are those of the source exactly.
/// Lips that close for a moment between two frames of the other rate would not be seen to: given
/// the landmarks, the frame nearest to such a moment shows it.
/// @param motion (T, ...) floating point
/// @param num_frames of the result, >= 1
/// @param landmarks (T, 68, 3) floating point, displacements of the same frames, m; undefined:
/// every frame shows its own time.
at::Tensor resample_motion(const at::Tensor& motion, double from_fps, double to_fps,
                           int64_t num_frames, const at::Tensor& landmarks = {});

}  // namespace freetalk::animation
