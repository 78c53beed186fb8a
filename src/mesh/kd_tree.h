// Nearest neighbours among points, and among oriented points.
#pragma once

#include <Eigen/Core>

#include <limits>
#include <vector>

#include "mesh/kd_order.h"

namespace freetalk::mesh {

struct Neighbour {
  int index;
  double distance;
};

class KdTree {
 public:
  /// @param points (3, N), normals (3, N) unit, or none if no query asks for them; both are copied.
  explicit KdTree(const Eigen::Matrix3Xd& points, const Eigen::Matrix3Xd& normals = {});

  /// Index of the point with the least |p - point|^2 + (normal_length |n - normal|)^2, if that is
  /// below max_distance^2 and the cosine of the normals at least `min_cosine`; -1 if there is none.
  int nearest(const Eigen::Vector3d& point, const Eigen::Vector3d& normal, double max_distance,
              double min_cosine, double normal_length) const;

  /// Up to `count` points within `radius`, nearest first, points at the same distance by index.
  /// @param except a point to leave out, -1 for none.
  std::vector<Neighbour> nearest(const Eigen::Vector3d& point, int count,
                                 double radius = std::numeric_limits<double>::infinity(),
                                 int except = -1) const;

  const Eigen::Matrix3Xd& points() const { return points_; }
  const Eigen::Matrix3Xd& normals() const { return normals_; }
  Eigen::Index size() const { return points_.cols(); }

 private:
  /// Visits the points of a range, those that `query` no longer reaches left out.
  template <class Query>
  void search(int begin, int end, const Eigen::Vector3d& point, Query& query) const;

  Eigen::Matrix3Xd points_;
  Eigen::Matrix3Xd normals_;
  KdOrder order_;
};

/// (V, count) indices of the points nearest to each point, nearest first, points at the same
/// distance by index, without the point itself. @param points (V, 3) finite. @param count 1 .. V-1.
Eigen::MatrixXi nearest_points(const Eigen::MatrixXd& points, int count);

}  // namespace freetalk::mesh
