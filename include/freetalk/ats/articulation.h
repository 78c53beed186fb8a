// How far the mouth goes, at the same closures.
#pragma once

#include <ATen/core/Tensor.h>

namespace freetalk::ats {

/// Scales the motion of lips and jaw about the neutral face by `gain`, except that an inner-lip gap
/// g of up to c = 1 mm beyond the neutral face's stays as it is, and a wider one becomes
/// c + gain (g - c): lips that close do so at every gain, lips that do not part are not pressed
/// into each other, and the order of gaps is kept. What this differs from plain scaling is shared
/// by upper and lower lip.
/// @param motion (..., 68, 3) landmark displacements, m, canonical frame. @param gain > 0; 1 gives
/// `motion` itself. @returns the same shape.
at::Tensor articulate(const at::Tensor& motion, double gain);

}  // namespace freetalk::ats
