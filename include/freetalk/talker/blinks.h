// Blinks where the model leaves the eyes open for long.
#pragma once

#include <ATen/core/Tensor.h>

#include <Eigen/Core>
#include <cstdint>

namespace freetalk::talker {

/// Closes the lids every 2.5 to 6 s, for 0.24 s, closing faster than opening [Trutoiu et al. 2011];
/// a blink within 1.5 s of one that the motion has itself is left out. The same seed gives the same
/// blinks.
/// @param motion (T, 68, 3) float32 m, changed in place. @param landmarks (68, 3) m, the
/// template's.
void add_blinks(at::Tensor& motion, const Eigen::MatrixXd& landmarks, double fps, uint64_t seed);

}  // namespace freetalk::talker
