#include "mesh/nearest_points.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "core/parallel.h"
#include "mesh/kd_order.h"

namespace freetalk::mesh {
namespace {

class Tree {
 public:
  explicit Tree(const Eigen::MatrixXd& points) : points_(points.transpose()), order_(points_) {}

  /// Fills `best` (empty) with the `count` nearest of `index`, as (squared distance, index).
  void nearest(int index, size_t count, std::vector<std::pair<double, int>>& best) const {
    search(0, static_cast<int>(order_.points.size()), index, count, best);
    std::sort_heap(best.begin(), best.end());
  }

 private:
  void visit(int other, int index, size_t count, std::vector<std::pair<double, int>>& best) const {
    if (other == index) return;
    const std::pair<double, int> found{(points_.col(other) - points_.col(index)).squaredNorm(),
                                       other};
    if (best.size() == count) {
      if (!(found < best.front())) return;
      std::pop_heap(best.begin(), best.end());
      best.pop_back();
    }
    best.push_back(found);
    std::push_heap(best.begin(), best.end());
  }

  void search(int begin, int end, int index, size_t count,
              std::vector<std::pair<double, int>>& best) const {
    if (end - begin <= KdOrder::leaf) {
      for (int i = begin; i < end; ++i) visit(order_.points[i], index, count, best);
      return;
    }
    const int middle = (begin + end) / 2;
    const int axis = order_.axis[middle];
    const double side = points_(axis, index) - points_(axis, order_.points[middle]);
    visit(order_.points[middle], index, count, best);
    const auto half = [&](bool lower) {
      lower ? search(begin, middle, index, count, best)
            : search(middle + 1, end, index, count, best);
    };
    half(side < 0.0);
    if (best.size() < count || side * side <= best.front().first) half(side >= 0.0);
  }

  Eigen::Matrix3Xd points_;
  KdOrder order_;
};

}  // namespace

Eigen::MatrixXi nearest_points(const Eigen::MatrixXd& points, int count) {
  const Tree tree(points);
  Eigen::MatrixXi result(points.rows(), count);
  core::parallel_for(0, points.rows(), 512, [&](int64_t begin, int64_t end) {
    std::vector<std::pair<double, int>> best;
    for (int64_t v = begin; v < end; ++v) {
      best.clear();
      tree.nearest(static_cast<int>(v), static_cast<size_t>(count), best);
      for (int i = 0; i < count; ++i) result(v, i) = best[static_cast<size_t>(i)].second;
    }
  });
  return result;
}

}  // namespace freetalk::mesh
