// The order of points in a balanced k-d tree in place.
#pragma once

#include <Eigen/Core>

#include <vector>

namespace freetalk::mesh {

/// A range of at most `leaf` points is a leaf; the middle of a larger one splits it along its
/// widest axis. The root is the whole range.
struct KdOrder {
  static constexpr int leaf = 8;

  /// @param positions (3, N).
  explicit KdOrder(const Eigen::Matrix3Xd& positions);

  std::vector<int> points;          ///< (N,) columns of the positions
  std::vector<unsigned char> axis;  ///< (N,) 0, 1 or 2 at the middle of a range
};

}  // namespace freetalk::mesh
