#include "tensor_conversion.h"

#include <ATen/ATen.h>

#include <algorithm>

namespace freetalk::geometry {
namespace {

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

}  // namespace

at::Tensor to_tensor(const Eigen::MatrixXd& matrix) {
  at::Tensor tensor = at::empty({matrix.rows(), matrix.cols()}, at::kDouble);
  Eigen::Map<RowMatrix>(tensor.data_ptr<double>(), matrix.rows(), matrix.cols()) = matrix;
  return tensor;
}

SparseOperator to_sparse_operator(const RowSparseMatrix& matrix) {
  RowSparseMatrix compressed = matrix;
  compressed.makeCompressed();
  at::Tensor rows = at::empty({compressed.rows() + 1}, at::kInt);
  at::Tensor columns = at::empty({compressed.nonZeros()}, at::kInt);
  at::Tensor values = at::empty({compressed.nonZeros()}, at::kDouble);
  std::copy_n(compressed.outerIndexPtr(), compressed.rows() + 1, rows.data_ptr<int32_t>());
  std::copy_n(compressed.innerIndexPtr(), compressed.nonZeros(), columns.data_ptr<int32_t>());
  std::copy_n(compressed.valuePtr(), compressed.nonZeros(), values.data_ptr<double>());
  return SparseOperator::from_rows(rows, columns, values, compressed.cols());
}

}  // namespace freetalk::geometry
