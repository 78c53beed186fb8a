#include "point_grid.h"

#include <algorithm>
#include <cmath>

namespace freetalk::animation {

PointGrid::PointGrid(const Eigen::MatrixXd& points, double cell) : points_(points), cell_(cell) {
  for (int64_t i = 0; i < points.rows(); ++i) {
    cells_[key(cell_of(points.row(i)))].push_back(static_cast<int>(i));
  }
}

PointGrid::Cell PointGrid::cell_of(const Eigen::Vector3d& point) const {
  return (point.array() / cell_).floor().cast<int64_t>();
}

int64_t PointGrid::key(const Cell& cell) {
  constexpr int64_t kOffset = int64_t{1} << 20;
  return ((cell[0] + kOffset) << 42) ^ ((cell[1] + kOffset) << 21) ^ (cell[2] + kOffset);
}

std::vector<Neighbour> PointGrid::nearest(const Eigen::Vector3d& point, int count,
                                          double radius) const {
  std::vector<Neighbour> found;
  const auto before = [](const Neighbour& a, const Neighbour& b) {
    return a.distance < b.distance || (a.distance == b.distance && a.index < b.index);
  };
  const Cell centre = cell_of(point);
  const auto rings = static_cast<int64_t>(std::ceil(radius / cell_));
  for (int64_t ring = 0; ring <= rings; ++ring) {
    for (int64_t x = -ring; x <= ring; ++x) {
      for (int64_t y = -ring; y <= ring; ++y) {
        // Inside the shell only its two faces along z are new.
        const bool side = std::max(std::abs(x), std::abs(y)) == ring;
        for (int64_t z = -ring; z <= ring; z += side || ring == 0 ? 1 : 2 * ring) {
          const auto cell = cells_.find(key(centre + Cell(x, y, z)));
          if (cell == cells_.end()) continue;
          for (const int i : cell->second) {
            const double distance = (points_.row(i).transpose() - point).norm();
            if (distance <= radius) found.push_back({i, distance});
          }
        }
      }
    }
    std::sort(found.begin(), found.end(), before);
    if (static_cast<int>(found.size()) > count) found.resize(count);
    const bool full = static_cast<int>(found.size()) == count;
    if (full && found.back().distance <= static_cast<double>(ring) * cell_) break;
  }
  return found;
}

}  // namespace freetalk::animation
