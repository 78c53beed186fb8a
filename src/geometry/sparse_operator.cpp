#include "freetalk/geometry/sparse_operator.h"

#include <ATen/ATen.h>

#include "freetalk/core/error.h"

namespace freetalk::geometry {
namespace {

/// Swallows torch's notice that sparse CSR is in beta, which says nothing to our users.
class Quiet final : public c10::WarningHandler {
  void process(const c10::Warning&) override {}
};

}  // namespace

SparseOperator SparseOperator::from_rows(const at::Tensor& rows, const at::Tensor& columns,
                                         const at::Tensor& values, int64_t num_columns) {
  FREETALK_CHECK(rows.dim() == 1 && rows.size(0) > 0 && columns.dim() == 1 &&
                     columns.sizes() == values.sizes() &&
                     rows.scalar_type() == columns.scalar_type() && num_columns >= 0,
                 "SparseOperator: expected rows (R + 1,), columns and values (N,) and indices of "
                 "one type, found ",
                 rows.sizes(), ", ", columns.sizes(), " and ", values.sizes());
  const auto indices = rows.options();
  const at::Tensor row_of_entry = at::repeat_interleave(
      at::arange(rows.size(0) - 1, indices), rows.diff(), 0, /*output_size=*/values.size(0));
  const at::Tensor order = at::argsort(columns, /*stable=*/true);
  SparseOperator result{rows, columns, values, {}, {}, {}};
  result.transposed_rows =
      at::searchsorted(columns.index_select(0, order), at::arange(num_columns + 1, indices))
          .to(rows.scalar_type());
  result.transposed_columns = row_of_entry.index_select(0, order);
  result.transposed_values = values.index_select(0, order);
  return result;
}

SparseOperator SparseOperator::transposed() const {
  return {transposed_rows, transposed_columns, transposed_values, rows, columns, values};
}

SparseOperator SparseOperator::scaled(double factor) const {
  SparseOperator result = *this;
  result.values = values * factor;
  result.transposed_values = transposed_values * factor;
  return result;
}

SparseOperator SparseOperator::to(at::ScalarType dtype, const c10::Device& device) const {
  return {rows.to(device),
          columns.to(device),
          values.to(device, dtype),
          transposed_rows.to(device),
          transposed_columns.to(device),
          transposed_values.to(device, dtype)};
}

at::Tensor SparseOperator::to_sparse_csr() const {
  Quiet quiet;
  const c10::WarningUtils::WarningHandlerGuard guard(&quiet);
  return at::_sparse_csr_tensor_unsafe(rows, columns, values, {num_rows(), num_columns()},
                                       values.options().layout(at::kSparseCsr));
}

SparseOperator concatenate_gradients(const std::vector<SparseOperator>& parts) {
  // The transposes: their rows are the meshes' vertices one after the other, and a column's new
  // place follows from its old one alone.
  std::vector<at::Tensor> rows, columns, values;
  int64_t num_rows = 0, entries = 0, first = 0;
  for (const SparseOperator& part : parts) num_rows += part.num_rows();
  for (const SparseOperator& part : parts) {
    const int64_t half = part.num_rows() / 2;
    rows.push_back(part.transposed_rows.narrow(0, 0, part.num_columns()) + entries);
    const at::Tensor& column = part.transposed_columns;
    columns.push_back(column + first + (column >= half) * (num_rows / 2 - half));
    values.push_back(part.transposed_values);
    entries += part.values.size(0);
    first += half;
  }
  const auto like = parts.front().rows.options();
  rows.push_back(at::full({1}, entries, like));
  return SparseOperator::from_rows(at::cat(rows), at::cat(columns).to(like.dtype()),
                                   at::cat(values), num_rows)
      .transposed();
}

}  // namespace freetalk::geometry
