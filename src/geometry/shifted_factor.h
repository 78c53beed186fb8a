// (L + s M) = P^T U D U^T P for any number of shifts s of either sign.
#pragma once

#include <cstdint>

#include "freetalk/geometry/surface.h"
#include "kernels/block_kernels.h"
#include "sparse_ldlt.h"

namespace freetalk::geometry {

using kernels::BlockKernels;
using kernels::kBlockWidth;
using kernels::TallBlock;

class ShiftedFactor {
 public:
  /// Keeps references to both.
  ShiftedFactor(const SparseMatrix& laplacian, const Eigen::VectorXd& mass)
      : laplacian_(laplacian), mass_(mass), ldlt_(laplacian) {}

  /// @return false if a pivot vanished or is not finite.
  bool factorize(double shift);

  /// Of L + s M for the shift last asked for.
  const SparseLdlt& ldlt() const { return ldlt_; }

  /// The number of eigenvalues below -s (Sylvester's law of inertia).
  int64_t num_negative() const;

 private:
  const SparseMatrix& laplacian_;
  const Eigen::VectorXd& mass_;
  SparseLdlt ldlt_;
};

}  // namespace freetalk::geometry
