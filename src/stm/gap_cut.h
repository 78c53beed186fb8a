// What a plane of constant x cuts of the two sides of a gap: lips, lids.
#pragma once

#include <ATen/core/TensorAccessor.h>
#include <Eigen/Core>

#include <array>
#include <optional>
#include <vector>

namespace freetalk::stm {

/// A place on a surface.
struct Spot {
  int face = 0;
  Eigen::RowVector3d at, shares;

  /// How far the place moves, m. @param moved (1, V, 3) displacements.
  Eigen::RowVector3d displacement(const Eigen::MatrixXi& faces,
                                  const at::TensorAccessor<float, 3>& moved) const;
};

class GapCut {
 public:
  /// In the plane halfway between two points, within 5 mm of them.
  /// @param vertices (V, 3) m. @param faces (F, 3).
  /// @param upper (V,) whether a vertex belongs to the upper side.
  /// @param top, bottom on the sides or near them.
  GapCut(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
         const std::vector<bool>& upper, const Eigen::RowVector3d& top,
         const Eigen::RowVector3d& bottom);

  /// Whether skin joins the sides.
  bool joined() const { return joined_; }
  /// m; nothing where a side is missing. Where skin joins the sides they are as far apart as the
  /// points, or closed.
  std::optional<double> clearance() const;
  /// Where the sides come nearest to each other; nothing where one is missing.
  std::optional<std::array<Spot, 2>> nearest() const;

 private:
  /// Keeps what of a segment is near the point of its side. @param uppers of its three corners.
  void sample(const Spot& from, const Spot& to, int uppers);

  std::array<Eigen::RowVector3d, 2> centre_;
  double x_;
  std::array<std::vector<Spot>, 2> sides_;
  bool joined_ = false;
};

}  // namespace freetalk::stm
