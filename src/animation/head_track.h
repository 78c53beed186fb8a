// The rigid motion of a head as files hold it.
#pragma once

#include <ATen/core/Tensor.h>

#include "freetalk/animation/animation.h"

namespace freetalk::animation {

struct HeadTrack {
  at::Tensor
      turns;  ///< (T, 4) float32 quaternions x, y, z, w, each the near one of two to the last
  at::Tensor shifts;  ///< (T, 3) float32
};

/// @param head (T, 4, 4) float64, the mesh's unit and axes. @return the same in metres, +Y up.
HeadTrack head_track(const at::Tensor& head, const MeshFrame& frame);

/// (4, 4) float64 of a quaternion x, y, z, w of any length but 0 and a shift.
at::Tensor head_pose(const double* turn, const double* shift);

}  // namespace freetalk::animation
