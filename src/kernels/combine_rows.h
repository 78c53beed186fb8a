// Sums of rows with given weights: a matrix product of few inner indices and very long rows.
#pragma once

#include <cstdint>

namespace freetalk::kernels {

/// out (T, C) = weights (T, n) rows (n, C), all row-major float32. The same bits for any number of
/// threads, and for a row of the result whatever other rows are asked for.
void combine_rows(const float* weights, int64_t num_sums, int64_t num_rows, const float* rows,
                  int64_t columns, float* out);

}  // namespace freetalk::kernels
