#include "kd_tree.h"

#include <algorithm>
#include <numeric>

namespace freetalk::geometry {
namespace {

constexpr int kLeafSize = 8;

}  // namespace

KdTree::KdTree(const Eigen::Matrix3Xd& points, const Eigen::Matrix3Xd& normals)
    : points_(points), normals_(normals) {
  const auto count = static_cast<int>(points.cols());
  order_.resize(static_cast<size_t>(count));
  axis_.assign(static_cast<size_t>(count), 0);
  std::iota(order_.begin(), order_.end(), 0);
  build(0, count);
}

void KdTree::build(int begin, int end) {
  if (end - begin <= kLeafSize) return;
  Eigen::Vector3d low = points_.col(order_[begin]);
  Eigen::Vector3d high = low;
  for (int i = begin + 1; i < end; ++i) {
    low = low.cwiseMin(points_.col(order_[i]));
    high = high.cwiseMax(points_.col(order_[i]));
  }
  int axis = 0;
  (high - low).maxCoeff(&axis);
  const int middle = (begin + end) / 2;
  std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end,
                   [&](int a, int b) { return points_(axis, a) < points_(axis, b); });
  axis_[middle] = static_cast<unsigned char>(axis);
  build(begin, middle);
  build(middle + 1, end);
}

void KdTree::search(int begin, int end, Query& query) const {
  const auto visit = [&](int index) {
    const double distance = (points_.col(index) - query.point).squaredNorm();
    if (distance >= query.best_squared) return;
    const double cosine = normals_.col(index).dot(query.normal);
    const double squared = distance + 2.0 * query.normal_squared * (1.0 - cosine);
    if (squared < query.best_squared && cosine >= query.min_cosine) {
      query.best_squared = squared;
      query.best = index;
    }
  };
  if (end - begin <= kLeafSize) {
    for (int i = begin; i < end; ++i) visit(order_[i]);
    return;
  }
  const int middle = (begin + end) / 2;
  visit(order_[middle]);
  const int axis = axis_[middle];
  const double side = query.point[axis] - points_(axis, order_[middle]);
  if (side < 0.0) {
    search(begin, middle, query);
    if (side * side < query.best_squared) search(middle + 1, end, query);
  } else {
    search(middle + 1, end, query);
    if (side * side < query.best_squared) search(begin, middle, query);
  }
}

int KdTree::nearest(const Eigen::Vector3d& point, const Eigen::Vector3d& normal,
                    double max_distance, double min_cosine, double normal_length) const {
  Query query{point, normal, max_distance * max_distance, min_cosine, normal_length * normal_length,
              -1};
  search(0, static_cast<int>(order_.size()), query);
  return query.best;
}

}  // namespace freetalk::geometry
