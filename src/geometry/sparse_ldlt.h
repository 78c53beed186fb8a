// A = P^T L D L^T P of a symmetric sparse matrix, without pivoting: supernodal and multifrontal
// (Duff & Reid 1983; Liu 1992), so that nearly all of the work runs in dense kernels, and parallel
// over subtrees of the elimination tree. The same bits for any number of threads.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <vector>

#include "elimination_tree.h"
#include "freetalk/geometry/surface.h"
#include "kernels/block_kernels.h"

namespace freetalk::geometry {

class SparseLdlt {
 public:
  /// @param matrix whose pattern is analysed: both halves, every diagonal entry stored.
  explicit SparseLdlt(const SparseMatrix& matrix);

  /// @param matrix of that pattern.
  /// @return false if a pivot vanished or is not finite.
  bool factorize(const SparseMatrix& matrix);

  int64_t size() const { return static_cast<int64_t>(tree_.order.size()); }
  /// Row i of the matrix is row position()[i] of what `solve` works on.
  const Eigen::VectorXi& position() const { return tree_.position; }
  /// (size,) D.
  const Eigen::VectorXd& pivots() const { return pivots_; }

  /// Rows that `solve` needs: those of the matrix, then its own.
  int64_t solve_rows() const { return solve_rows_; }
  /// x <- A^-1 x for eight columns. @param x solve_rows() rows, the first size() of them in the
  /// factor's order.
  void solve(kernels::TallBlock& x) const;

 private:
  struct Work;
  void eliminate(int node, const SparseMatrix& matrix, Work& work);
  void assemble(int node, const SparseMatrix& matrix, Work& work);
  void solve_lower(int node, double* x) const;
  void solve_upper(int node, double* x) const;
  void place_rows();

  EliminationTree tree_;
  std::vector<int> solve_row_;  // as EliminationTree::rows; a subtree's rows above it are its own
  std::vector<int64_t> subtree_rows_;  // of each subtree: where its own rows begin in x
  int64_t solve_rows_ = 0;
  std::vector<double> panels_;
  std::vector<std::vector<double>> updates_;  // of each supernode to its parent: upper half by rows
  Eigen::VectorXd pivots_, inverse_pivots_;
};

}  // namespace freetalk::geometry
