// Nearest points among many, by cells of a regular grid.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <unordered_map>
#include <vector>

namespace freetalk::animation {

struct Neighbour {
  int index;
  double distance;
};

class PointGrid {
 public:
  /// @param points (N, 3). @param cell edge of a cell, about the distance that is searched most.
  PointGrid(const Eigen::MatrixXd& points, double cell);

  /// Up to `count` points within `radius`, nearest first (ties by index).
  std::vector<Neighbour> nearest(const Eigen::Vector3d& point, int count, double radius) const;

 private:
  using Cell = Eigen::Array<int64_t, 3, 1>;
  Eigen::MatrixXd points_;
  double cell_;
  std::unordered_map<int64_t, std::vector<int>> cells_;

  Cell cell_of(const Eigen::Vector3d& point) const;
  static int64_t key(const Cell& cell);
};

}  // namespace freetalk::animation
