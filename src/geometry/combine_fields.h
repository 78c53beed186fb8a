// Sums of fields over a mesh with given weights.
#pragma once

#include <ATen/core/Tensor.h>

#include "greedy_interpolation.h"

namespace freetalk::geometry {

/// (T, ...) = weights (T, n) times fields (n, ...) float32, on the fields' device. On a CPU the
/// bits of a sum depend neither on the number of threads nor on what other sums are asked for.
at::Tensor combine_fields(const GreedyInterpolation::Points& weights, const at::Tensor& fields);

}  // namespace freetalk::geometry
