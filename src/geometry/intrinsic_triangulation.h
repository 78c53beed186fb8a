// Triangles known by their edge lengths alone, glued along sides: a closed oriented surface that
// needs no embedding. A triangle may be glued to itself and two triangles along several sides.
#pragma once

#include <Eigen/Core>

#include <vector>

#include "freetalk/geometry/surface.h"

namespace freetalk::geometry {

/// Side s = 3 f + c runs from corner c of triangle f to corner c + 1.
class IntrinsicTriangulation {
 public:
  /// @param tails (3 T) vertex each side starts from.
  /// @param twins (3 T) the side each is glued to, which runs the other way.
  /// @param lengths (3 T) > 0, equal for twins, within the triangle inequality.
  IntrinsicTriangulation(std::vector<int> tails, std::vector<int> twins,
                         std::vector<double> lengths);

  /// Flips edges until every cotangent weight is at least -tolerance (queue of Bobenko & Springborn
  /// 2007). @return the number of flips.
  int64_t flip_to_delaunay(double tolerance);

  /// (V, V) cotangent Laplacian, positive semi-definite.
  SparseMatrix laplacian(Eigen::Index num_vertices) const;
  /// (V,) a third of the area of the triangles around.
  Eigen::VectorXd lumped_mass(Eigen::Index num_vertices) const;

 private:
  static int next(int side) { return side % 3 == 2 ? side - 2 : side + 1; }
  int tip(int side) const { return tails_[static_cast<size_t>(next(side))]; }
  double area(int side) const;
  double half_cotangent(int side) const;
  double weight(int side) const;
  double flipped_length(int side) const;
  bool flip(int side);

  std::vector<int> tails_;
  std::vector<int> twins_;
  std::vector<double> lengths_;
};

}  // namespace freetalk::geometry
