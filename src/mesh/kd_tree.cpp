#include "mesh/kd_tree.h"

namespace freetalk::mesh {

KdTree::KdTree(const Eigen::Matrix3Xd& points, const Eigen::Matrix3Xd& normals)
    : points_(points), normals_(normals), order_(points) {}

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
  if (end - begin <= KdOrder::leaf) {
    for (int i = begin; i < end; ++i) visit(order_.points[i]);
    return;
  }
  const int middle = (begin + end) / 2;
  visit(order_.points[middle]);
  const int axis = order_.axis[middle];
  const double side = query.point[axis] - points_(axis, order_.points[middle]);
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
  search(0, static_cast<int>(order_.points.size()), query);
  return query.best;
}

}  // namespace freetalk::mesh
