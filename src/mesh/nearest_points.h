// The nearest points of each point of a cloud.
#pragma once

#include <Eigen/Core>

namespace freetalk::mesh {

/// (V, count) indices of the points nearest to each point, nearest first, points at the same
/// distance by index, without the point itself. @param points (V, 3) finite. @param count 1 .. V-1.
Eigen::MatrixXi nearest_points(const Eigen::MatrixXd& points, int count);

}  // namespace freetalk::mesh
