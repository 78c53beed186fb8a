#include "mesh/kd_tree.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/parallel.h"

namespace freetalk::mesh {
namespace {

/// The best oriented point so far.
struct OrientedQuery {
  const Eigen::Matrix3Xd& points;
  const Eigen::Matrix3Xd& normals;
  const Eigen::Vector3d& point;
  const Eigen::Vector3d& normal;
  double best_squared;
  double min_cosine;
  double normal_squared;
  int best = -1;

  bool reaches(double squared) const { return squared < best_squared; }
  void visit(int index) {
    const double distance = (points.col(index) - point).squaredNorm();
    if (distance >= best_squared) return;
    const double cosine = normals.col(index).dot(normal);
    const double squared = distance + 2.0 * normal_squared * (1.0 - cosine);
    if (squared < best_squared && cosine >= min_cosine) {
      best_squared = squared;
      best = index;
    }
  }
};

/// The nearest so far, a heap of (squared distance, index) with the farthest in front.
struct NearestQuery {
  const Eigen::Matrix3Xd& points;
  const Eigen::Vector3d& point;
  size_t count;
  double squared_radius;
  int except;
  std::vector<std::pair<double, int>> best;

  bool reaches(double squared) const {
    return squared <= (best.size() < count ? squared_radius : best.front().first);
  }
  void visit(int index) {
    if (index == except) return;
    const std::pair<double, int> found{(points.col(index) - point).squaredNorm(), index};
    if (found.first > squared_radius) return;
    if (best.size() == count) {
      if (!(found < best.front())) return;
      std::pop_heap(best.begin(), best.end());
      best.pop_back();
    }
    best.push_back(found);
    std::push_heap(best.begin(), best.end());
  }
};

}  // namespace

KdTree::KdTree(const Eigen::Matrix3Xd& points, const Eigen::Matrix3Xd& normals)
    : points_(points), normals_(normals), order_(points) {}

template <class Query>
void KdTree::search(int begin, int end, const Eigen::Vector3d& point, Query& query) const {
  if (end - begin <= KdOrder::leaf) {
    for (int i = begin; i < end; ++i) query.visit(order_.points[i]);
    return;
  }
  const int middle = (begin + end) / 2;
  query.visit(order_.points[middle]);
  const int axis = order_.axis[middle];
  const double side = point[axis] - points_(axis, order_.points[middle]);
  if (side < 0.0) {
    search(begin, middle, point, query);
    if (query.reaches(side * side)) search(middle + 1, end, point, query);
  } else {
    search(middle + 1, end, point, query);
    if (query.reaches(side * side)) search(begin, middle, point, query);
  }
}

int KdTree::nearest(const Eigen::Vector3d& point, const Eigen::Vector3d& normal,
                    double max_distance, double min_cosine, double normal_length) const {
  OrientedQuery query{points_,
                      normals_,
                      point,
                      normal,
                      max_distance * max_distance,
                      min_cosine,
                      normal_length * normal_length};
  search(0, static_cast<int>(size()), point, query);
  return query.best;
}

std::vector<Neighbour> KdTree::nearest(const Eigen::Vector3d& point, int count, double radius,
                                       int except) const {
  NearestQuery query{points_, point, static_cast<size_t>(count), radius * radius, except, {}};
  query.best.reserve(query.count);
  search(0, static_cast<int>(size()), point, query);
  std::sort_heap(query.best.begin(), query.best.end());
  std::vector<Neighbour> result;
  result.reserve(query.best.size());
  for (const auto& [squared, index] : query.best) result.push_back({index, std::sqrt(squared)});
  return result;
}

Eigen::MatrixXi nearest_points(const Eigen::MatrixXd& points, int count) {
  const KdTree tree(points.transpose());
  Eigen::MatrixXi result(points.rows(), count);
  core::parallel_for(0, points.rows(), 512, [&](int64_t begin, int64_t end) {
    for (int64_t v = begin; v < end; ++v) {
      const auto nearest =
          tree.nearest(points.row(v).transpose(), count, std::numeric_limits<double>::infinity(),
                       static_cast<int>(v));
      for (int i = 0; i < count; ++i) result(v, i) = nearest[static_cast<size_t>(i)].index;
    }
  });
  return result;
}

}  // namespace freetalk::mesh
