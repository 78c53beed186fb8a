#include "tensor_conversion.h"

#include <ATen/ATen.h>
#include <c10/util/Exception.h>

#include <algorithm>
#include <vector>

namespace freetalk::geometry {
namespace {

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Swallows torch's notice that sparse CSR is in beta, which says nothing to our users.
class Quiet final : public c10::WarningHandler {
  void process(const c10::Warning&) override {}
};

}  // namespace

at::Tensor make_csr_tensor(const at::Tensor& crow_indices, const at::Tensor& col_indices,
                           const at::Tensor& values, at::IntArrayRef sizes) {
  Quiet quiet;
  const c10::WarningUtils::WarningHandlerGuard guard(&quiet);
  return at::sparse_csr_tensor(crow_indices, col_indices, values, sizes,
                               values.options().layout(at::kSparseCsr));
}

at::Tensor csr_with_values(const at::Tensor& csr, const at::Tensor& values) {
  return make_csr_tensor(csr.crow_indices(), csr.col_indices(), values, csr.sizes());
}

at::Tensor to_tensor(const Eigen::MatrixXd& matrix) {
  at::Tensor tensor = at::empty({matrix.rows(), matrix.cols()}, at::kDouble);
  Eigen::Map<RowMatrix>(tensor.data_ptr<double>(), matrix.rows(), matrix.cols()) = matrix;
  return tensor;
}

at::Tensor to_csr_tensor(const RowSparseMatrix& matrix) {
  RowSparseMatrix compressed = matrix;
  compressed.makeCompressed();
  at::Tensor rows = at::empty({compressed.rows() + 1}, at::kLong);
  at::Tensor cols = at::empty({compressed.nonZeros()}, at::kLong);
  at::Tensor values = at::empty({compressed.nonZeros()}, at::kDouble);
  std::copy_n(compressed.outerIndexPtr(), compressed.rows() + 1, rows.data_ptr<int64_t>());
  std::copy_n(compressed.innerIndexPtr(), compressed.nonZeros(), cols.data_ptr<int64_t>());
  std::copy_n(compressed.valuePtr(), compressed.nonZeros(), values.data_ptr<double>());
  return make_csr_tensor(rows, cols, values, {compressed.rows(), compressed.cols()});
}

at::Tensor transpose_csr(const at::Tensor& csr) {
  const int64_t num_rows = csr.size(0);
  const int64_t num_cols = csr.size(1);
  const at::Tensor in_rows = csr.crow_indices().contiguous();
  const at::Tensor in_cols = csr.col_indices().contiguous();
  const at::Tensor in_values = csr.values().contiguous();
  const int64_t* crow = in_rows.data_ptr<int64_t>();
  const int64_t* col = in_cols.data_ptr<int64_t>();
  const double* value = in_values.data_ptr<double>();
  const int64_t count = in_values.size(0);
  at::Tensor rows = at::zeros({num_cols + 1}, at::kLong);
  at::Tensor cols = at::empty({count}, at::kLong);
  at::Tensor values = at::empty({count}, at::kDouble);
  int64_t* out_row = rows.data_ptr<int64_t>();
  for (int64_t i = 0; i < count; ++i) ++out_row[col[i] + 1];
  for (int64_t c = 0; c < num_cols; ++c) out_row[c + 1] += out_row[c];
  std::vector<int64_t> next(out_row, out_row + num_cols);
  for (int64_t r = 0; r < num_rows; ++r) {
    for (int64_t i = crow[r]; i < crow[r + 1]; ++i) {
      const int64_t at = next[static_cast<size_t>(col[i])]++;
      cols.data_ptr<int64_t>()[at] = r;
      values.data_ptr<double>()[at] = value[i];
    }
  }
  return make_csr_tensor(rows, cols, values, {num_cols, num_rows});
}

}  // namespace freetalk::geometry
