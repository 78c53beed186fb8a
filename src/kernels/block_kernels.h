// Blocks of eight tall columns stored by rows: a row is one 64-byte line, so that products between
// blocks and triangular solves (ldlt_kernels.h) run eight right-hand sides at a time.
#pragma once

#include <cstdint>
#include <cstdlib>
#include <memory>
#include <utility>

namespace freetalk::kernels {

constexpr int64_t kBlockWidth = 8;

/// (rows, 8) doubles, row-major, aligned to cache lines; not initialised.
class TallBlock {
 public:
  explicit TallBlock(int64_t rows);

  int64_t rows() const { return rows_; }
  double* row(int64_t r) { return data_.get() + r * kBlockWidth; }
  const double* row(int64_t r) const { return data_.get() + r * kBlockWidth; }
  double* data() { return data_.get(); }
  const double* data() const { return data_.get(); }

 private:
  struct Free {
    void operator()(double* data) const { std::free(data); }
  };
  int64_t rows_;
  std::unique_ptr<double[], Free> data_;
};

struct BlockKernels {
  /// out (8, 8) += a^T b over rows [0, rows).
  void (*add_gram)(const double* a, const double* b, int64_t rows, double* out);
  /// target (rows, 8) -= a (rows, 8) c (8, 8).
  void (*subtract_product)(const double* a, const double* c, int64_t rows, double* target);
};

/// The kernels for isa().
const BlockKernels& block_kernels();

}  // namespace freetalk::kernels
