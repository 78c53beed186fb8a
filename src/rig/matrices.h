// Between tensors of landmark motion and Eigen.
#pragma once

#include <ATen/core/Tensor.h>
#include <Eigen/Core>

#include "geometry/combine_fields.h"

namespace freetalk::rig {

using Rows = geometry::GreedyInterpolation::Points;  // double, row-major

/// (N, 68, 3) m to (N, 204) mm.
Rows landmark_rows(const at::Tensor& landmarks);
/// (N, M) float64 or float32.
Rows to_rows(const at::Tensor& matrix);
at::Tensor to_tensor(const Rows& rows);

/// (N, M) scalar products of fields (N, ...) and (M, ...) float32, summed in double in one order.
Rows products(const at::Tensor& a, const at::Tensor& b);

}  // namespace freetalk::rig
