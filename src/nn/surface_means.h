// Means over whole meshes, of one or of a batch laid one after the other.
#pragma once

#include <ATen/core/Tensor.h>

#include "freetalk/geometry/operators.h"

namespace freetalk::nn {

/// Mass-weighted mean over each mesh. @param x (B, V, C). @returns (B, meshes, C).
at::Tensor weighted_means(const at::Tensor& x, const geometry::SurfaceOperators& operators);

/// A value of each mesh at its vertices. @param x (B, meshes, C). @returns (B, V, C), or (B, 1, C)
/// to be broadcast where there is one mesh.
at::Tensor at_vertices(const at::Tensor& x, const geometry::SurfaceOperators& operators);

}  // namespace freetalk::nn
