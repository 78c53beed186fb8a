// A constant sparse matrix and its transpose by compressed rows, as plain tensors.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <vector>

namespace freetalk::geometry {

/// A matrix (R, V) with N entries. Multiply with nn::sparse_product (nn/sparse.h), to which the
/// tensors are arguments: they are shared between copies and never change.
struct SparseOperator {
  at::Tensor rows;                ///< (R + 1,) int32 or int64: first entry of each row, and the end
  at::Tensor columns;             ///< (N,) of rows's dtype
  at::Tensor values;              ///< (N,) floating
  at::Tensor transposed_rows;     ///< (V + 1,): the same of the transpose
  at::Tensor transposed_columns;  ///< (N,)
  at::Tensor transposed_values;   ///< (N,)

  /// Finds the transpose, on the tensors' device and without waiting for it.
  /// @throws std::invalid_argument the tensors do not fit together.
  static SparseOperator from_rows(const at::Tensor& rows, const at::Tensor& columns,
                                  const at::Tensor& values, int64_t num_columns);

  int64_t num_rows() const { return rows.size(0) - 1; }
  int64_t num_columns() const { return transposed_rows.size(0) - 1; }

  /// (V, R), nothing copied.
  SparseOperator transposed() const;
  /// Every value times `factor`.
  SparseOperator scaled(double factor) const;
  SparseOperator to(at::ScalarType dtype, const c10::Device& device) const;
  /// (R, V) as torch's own sparse CSR tensor, nothing copied.
  at::Tensor to_sparse_csr() const;
};

/// Stacked gradients (2 N_m, V_m) of several meshes as one (2 N, V): X components of all meshes,
/// then Y components of all. Of one dtype, on one device, without waiting for it.
SparseOperator concatenate_gradients(const std::vector<SparseOperator>& parts);

}  // namespace freetalk::geometry
