// (L + s M) = P^T U D U^T P by sparse LDL^T in an order that keeps U sparse, for any number of
// shifts s of either sign.
#pragma once

#include <Eigen/SparseCholesky>

#include <cstdint>

#include "freetalk/geometry/surface.h"
#include "kernels/block_kernels.h"

namespace freetalk::geometry {

using kernels::BlockKernels;
using kernels::kBlockWidth;
using kernels::TallBlock;
using kernels::UnitLower;

class ShiftedFactor {
 public:
  /// Keeps references to both.
  ShiftedFactor(const SparseMatrix& laplacian, const Eigen::VectorXd& mass);

  /// @return false if a pivot vanished or is not finite.
  bool factorize(double shift);

  /// Row i of the given matrix is row order()[i] of what `solve` works on.
  const Eigen::VectorXi& order() const { return order_; }

  /// x <- (L + s M)^-1 x, rows in the factor's order.
  void solve(TallBlock& x) const;

  /// The number of eigenvalues below -s (Sylvester's law of inertia).
  int64_t num_negative() const;

 private:
  const SparseMatrix& laplacian_;
  const Eigen::VectorXd& mass_;
  Eigen::SimplicialLDLT<SparseMatrix> factor_;
  Eigen::VectorXi order_;
  Eigen::VectorXd inverse_pivots_;
};

}  // namespace freetalk::geometry
