// Rows of a sparse matrix times dense rows of channels, on the caller's thread.
#pragma once

#include <cstdint>

namespace freetalk::kernels {

/// A matrix by compressed rows.
template <class Value, class Index>
struct SparseRows {
  const Index* first;   // (rows + 1,) of each row's entries
  const Index* column;  // (entries,)
  const Value* value;   // (entries,)
};

/// y (end - begin, channels) = rows [begin, end) of the matrix times x (columns, channels), both
/// row-major; a row's sums run in the order of its entries. Value: float or double; Index: int32_t
/// or int64_t.
template <class Value, class Index>
void multiply_rows(const SparseRows<Value, Index>& matrix, int64_t begin, int64_t end,
                   const Value* x, int64_t channels, Value* y);

}  // namespace freetalk::kernels
