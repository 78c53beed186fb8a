#include "mesh/kd_order.h"

#include <algorithm>
#include <numeric>

namespace freetalk::mesh {
namespace {

void split(const Eigen::Matrix3Xd& points, int begin, int end, KdOrder& order) {
  if (end - begin <= KdOrder::leaf) return;
  std::vector<int>& at = order.points;
  Eigen::Vector3d low = points.col(at[begin]);
  Eigen::Vector3d high = low;
  for (int i = begin + 1; i < end; ++i) {
    low = low.cwiseMin(points.col(at[i]));
    high = high.cwiseMax(points.col(at[i]));
  }
  int axis = 0;
  (high - low).maxCoeff(&axis);
  const int middle = (begin + end) / 2;
  std::nth_element(at.begin() + begin, at.begin() + middle, at.begin() + end,
                   [&](int a, int b) { return points(axis, a) < points(axis, b); });
  order.axis[middle] = static_cast<unsigned char>(axis);
  split(points, begin, middle, order);
  split(points, middle + 1, end, order);
}

}  // namespace

KdOrder::KdOrder(const Eigen::Matrix3Xd& positions)
    : points(static_cast<size_t>(positions.cols())), axis(points.size()) {
  std::iota(points.begin(), points.end(), 0);
  split(positions, 0, static_cast<int>(positions.cols()), *this);
}

}  // namespace freetalk::mesh
