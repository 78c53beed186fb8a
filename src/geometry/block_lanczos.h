// Block Lanczos on the shift-inverted, mass-normalised problem
//   A v = theta v,  A = D (L + s M)^-1 D,  D = M^1/2,  theta = 1 / (lambda + s),  phi = D^-1 v,
// whose largest eigenvalues are the smallest lambda: the basis V of the Krylov space of eight
// random vectors, in which A is block tridiagonal (Golub & Underwood 1977; Grimes, Lewis & Simon
// 1994). Eight at a time, a pass over the factor or over V serves eight vectors, for a space that
// is 10 to 15 % larger than that of one vector.
//
// A Ritz pair (theta, y = V s) has A y - theta y = W s_last, W the next block before it is made
// orthonormal. y + W s_last / theta = A y / theta is returned: one step of the power method that
// costs nothing. Its residual in the given problem, relative to lambda + s, is |W s_last| / theta.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <functional>
#include <vector>

#include "kernels/block_kernels.h"
#include "shifted_factor.h"

namespace freetalk::geometry {

class BlockLanczos {
 public:
  using Small = Eigen::Matrix<double, kBlockWidth, kBlockWidth, Eigen::RowMajor>;

  /// @param factor of L + shift M; kept by reference.
  /// @param mass (V,) > 0.
  /// @param known (V, C) M-orthonormal eigenvectors to stay clear of; C may be 0.
  BlockLanczos(const ShiftedFactor& factor, const Eigen::VectorXd& mass, double shift,
               const Eigen::MatrixXd& known);

  /// Grows the space until `count` pairs have residuals (relative to max(lambda, floor)) of at most
  /// `tolerance`. False if it has `max_dimension` dimensions before, or lost its orthogonality.
  bool run(int64_t count, double tolerance, double floor, int64_t max_dimension,
           const std::function<void(double)>& progress);

  /// The smallest of all Ritz values of the space, ascending, `count` of them at most.
  Eigen::VectorXd evals(int64_t count) const;
  /// (V, count) their M-orthonormal vectors.
  Eigen::MatrixXd evecs(int64_t count) const;

 private:
  void start();
  void step();
  void clear_last_two(TallBlock& x);
  std::vector<const TallBlock*> before(size_t count) const;
  TallBlock apply(const TallBlock& x);
  void clear_of_basis(TallBlock& x) const;
  Small orthonormalize(TallBlock& x) const;
  Small orthonormalize_columns(TallBlock& x) const;
  void decompose();
  double worst_residual(int64_t count, double floor) const;
  int64_t dimension() const { return kBlockWidth * static_cast<int64_t>(diagonal_.size()); }

  const SparseLdlt& factor_;
  double shift_;
  Eigen::VectorXd root_mass_;  // in the factor's order, as all blocks
  TallBlock solved_;           // work space of apply
  std::vector<TallBlock> known_;
  std::vector<TallBlock> basis_;  // one more than diagonal_ after the first step
  std::vector<Small> diagonal_;   // T_jj
  std::vector<Small> below_;      // T_(j+1)j
  int period_ = 2;                // steps between two clearings
  int steps_since_clearing_ = 0;
  bool spoiled_ = false;   // orthogonality was lost: T is no projection of A
  Eigen::VectorXd theta_;  // descending
  Eigen::MatrixXd ritz_;   // (dimension, dimension)
};

/// The dimension at which `count` pairs are first expected to have converged.
int64_t block_lanczos_dimension(int64_t count);

}  // namespace freetalk::geometry
