// The symbolic half of sparse_ldlt.h: an order that keeps the factor sparse, the supernodes of its
// columns, and how they are cut into subtrees that different threads can eliminate.
#pragma once

#include <cstdint>
#include <vector>

#include "freetalk/geometry/surface.h"

namespace freetalk::geometry {

/// Consecutive columns of L with the same rows below their triangle (a few zeros stored).
struct Supernode {
  int first, width;  // columns
  int64_t rows;      // of its rows below: where they begin in EliminationTree::rows
  int64_t num_rows;  // below
  int64_t panel;     // where its (width, width + num_rows) panel begins among all panels' values
  int parent;        // -1: none
  int begin;         // the first supernode of its subtree, which ends with itself
  int64_t size() const { return width + num_rows; }
};

struct EliminationTree {
  /// Of a symmetric pattern with every diagonal entry stored, both halves.
  explicit EliminationTree(const SparseMatrix& matrix);

  std::vector<int> order;        // column of L -> row of the matrix
  Eigen::VectorXi position;      // row of the matrix -> column of L
  std::vector<Supernode> nodes;  // children before parents
  std::vector<int> rows;         // of all supernodes, ascending within each
  std::vector<std::vector<int>> children;
  int64_t num_values = 0;  // of all panels
  /// Roots of disjoint subtrees, the dearest first. What they are depends on the pattern alone.
  std::vector<int> subtrees;
  std::vector<int> top;  // the supernodes above all of them, children before parents

 private:
  void order_columns(const SparseMatrix& matrix, std::vector<int>& parent, std::vector<int>& count);
  void find_supernodes(const std::vector<int>& parent, const std::vector<int>& count);
  void find_rows(const SparseMatrix& matrix);
  void cut();
};

}  // namespace freetalk::geometry
