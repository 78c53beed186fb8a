// The inverse of a deformation: which point moves to a given one.
#pragma once

#include <ATen/core/Tensor.h>

#include <functional>

namespace freetalk::head {

/// x -> delta(x) of points (B, N, 3), and its derivatives (B, N, 3, 3).
struct Offsets {
  std::function<at::Tensor(const at::Tensor&)> value;
  std::function<at::Tensor(const at::Tensor&)> jacobian;
};

/// x with x + delta(x) = target, by Broyden's method from the Jacobian of the first guess; the best
/// iterate of each point. Where gradients are recorded, they are those of the implicit function:
/// dx = (I + d delta / dx)^-1 (d target - d delta).
/// @param target (B, N, 3) head units. @returns (B, N, 3).
at::Tensor invert(const Offsets& offsets, const at::Tensor& target);

}  // namespace freetalk::head
