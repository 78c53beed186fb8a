// Sparse LDL^T of a symmetric positive definite matrix, in double, for many right-hand sides.
#pragma once

#include <cstdint>
#include <memory>

#include "freetalk/geometry/surface.h"

namespace freetalk::geometry {

class SparseCholesky {
 public:
  /// @throws std::runtime_error if the matrix is not positive definite.
  explicit SparseCholesky(const SparseMatrix& matrix);
  ~SparseCholesky();
  SparseCholesky(SparseCholesky&&) noexcept;
  SparseCholesky& operator=(SparseCholesky&&) noexcept;

  /// Factors another matrix of the same pattern, which saves the ordering.
  void refactor(const SparseMatrix& matrix);

  /// Solves in place, the columns in blocks over the threads.
  /// @param x (V, R) row-major: right-hand sides, then solutions.
  void solve(double* x, int64_t num_columns) const;

 private:
  struct Factor;
  std::unique_ptr<Factor> factor_;
};

}  // namespace freetalk::geometry
