// The kernels of block_kernels.h, included by block_kernels.cpp once for each instruction set (no
// include guard, no includes: every inclusion is compiled within its own namespace and target).

typedef double Row __attribute__((vector_size(64), may_alias));

inline void add_gram(const double* a, const double* b, int64_t rows, double* out) {
  Row sums[8];
  for (int i = 0; i < 8; ++i) sums[i] = reinterpret_cast<const Row*>(out)[i];
  const Row* right = reinterpret_cast<const Row*>(b);
  for (int64_t r = 0; r < rows; ++r) {
    const Row value = right[r];
    const double* left = a + 8 * r;
    for (int i = 0; i < 8; ++i) sums[i] += left[i] * value;
  }
  for (int i = 0; i < 8; ++i) reinterpret_cast<Row*>(out)[i] = sums[i];
}

inline void subtract_product(const double* a, const double* c, int64_t rows, double* target) {
  Row factors[8];
  for (int i = 0; i < 8; ++i) factors[i] = reinterpret_cast<const Row*>(c)[i];
  Row* out = reinterpret_cast<Row*>(target);
  for (int64_t r = 0; r < rows; ++r) {
    const double* left = a + 8 * r;
    Row even = out[r] - left[0] * factors[0];  // Two chains: half the latency.
    Row odd = left[1] * factors[1];
    for (int i = 2; i < 8; i += 2) {
      even -= left[i] * factors[i];
      odd += left[i + 1] * factors[i + 1];
    }
    out[r] = even - odd;
  }
}

inline void solve_lower(const UnitLower& lower, double* x) {
  Row* rows = reinterpret_cast<Row*>(x);
  for (int64_t c = 0; c < lower.size; ++c) {
    const Row solved = rows[c];
    for (int i = lower.column_begin[c]; i < lower.column_begin[c + 1]; ++i) {
      rows[lower.row[i]] -= lower.value[i] * solved;
    }
  }
}

inline void solve_upper(const UnitLower& lower, const double* inverse_pivots, double* x) {
  Row* rows = reinterpret_cast<Row*>(x);
  for (int64_t c = lower.size - 1; c >= 0; --c) {
    Row even = rows[c] * inverse_pivots[c];
    Row odd = {};
    int i = lower.column_begin[c];
    const int end = lower.column_begin[c + 1];
    for (; i + 1 < end; i += 2) {
      even -= lower.value[i] * rows[lower.row[i]];
      odd += lower.value[i + 1] * rows[lower.row[i + 1]];
    }
    if (i < end) even -= lower.value[i] * rows[lower.row[i]];
    rows[c] = even - odd;
  }
}
