// Nearest neighbours among oriented points.
#pragma once

#include <Eigen/Core>

#include "mesh/kd_order.h"

namespace freetalk::mesh {

class KdTree {
 public:
  /// @param points (3, N), normals (3, N) unit; both are copied.
  KdTree(const Eigen::Matrix3Xd& points, const Eigen::Matrix3Xd& normals);

  /// Index of the point with the least |p - point|^2 + (normal_length |n - normal|)^2, if that is
  /// below max_distance^2 and the cosine of the normals at least `min_cosine`; -1 if there is none.
  int nearest(const Eigen::Vector3d& point, const Eigen::Vector3d& normal, double max_distance,
              double min_cosine, double normal_length) const;

  const Eigen::Matrix3Xd& points() const { return points_; }
  const Eigen::Matrix3Xd& normals() const { return normals_; }
  Eigen::Index size() const { return points_.cols(); }

 private:
  struct Query {
    Eigen::Vector3d point;
    Eigen::Vector3d normal;
    double best_squared;
    double min_cosine;
    double normal_squared;
    int best;
  };

  void search(int begin, int end, Query& query) const;

  Eigen::Matrix3Xd points_;
  Eigen::Matrix3Xd normals_;
  KdOrder order_;
};

}  // namespace freetalk::mesh
