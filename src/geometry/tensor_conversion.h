// Eigen <-> ATen, float64 on the CPU.
#pragma once

#include <ATen/core/Tensor.h>
#include <Eigen/Core>

#include "freetalk/geometry/surface.h"

namespace freetalk::geometry {

/// (R, C) row-major copy.
at::Tensor to_tensor(const Eigen::MatrixXd& matrix);
/// Sparse CSR with int64 indices.
at::Tensor to_csr_tensor(const RowSparseMatrix& matrix);
/// A sparse CSR tensor of its parts (indices int64).
at::Tensor make_csr_tensor(const at::Tensor& crow_indices, const at::Tensor& col_indices,
                           const at::Tensor& values, at::IntArrayRef sizes);
/// A sparse CSR tensor with the pattern of another.
at::Tensor csr_with_values(const at::Tensor& csr, const at::Tensor& values);
/// The transpose of a sparse CSR tensor, in CSR.
at::Tensor transpose_csr(const at::Tensor& csr);

}  // namespace freetalk::geometry
