// Eigen <-> ATen, float64 on the CPU.
#pragma once

#include <ATen/core/Tensor.h>
#include <Eigen/Core>

#include "freetalk/geometry/sparse_operator.h"
#include "freetalk/geometry/surface.h"

namespace freetalk::geometry {

/// (R, C) row-major copy.
at::Tensor to_tensor(const Eigen::MatrixXd& matrix);
/// Indices int32, as Eigen's.
SparseOperator to_sparse_operator(const RowSparseMatrix& matrix);

}  // namespace freetalk::geometry
