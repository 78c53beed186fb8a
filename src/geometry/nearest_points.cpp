#include "nearest_points.h"

#include <ATen/Parallel.h>

#include <algorithm>
#include <numeric>
#include <utility>
#include <vector>

namespace freetalk::geometry {
namespace {

/// A k-d tree in place: the middle of a range splits it along its widest axis.
class Tree {
 public:
  explicit Tree(const Eigen::MatrixXd& points)
      : points_(points.transpose()),
        order_(static_cast<size_t>(points.rows())),
        axis_(order_.size()) {
    std::iota(order_.begin(), order_.end(), 0);
    build(0, static_cast<int>(order_.size()));
  }

  /// Fills `best` (empty) with the `count` nearest of `index`, as (squared distance, index).
  void nearest(int index, size_t count, std::vector<std::pair<double, int>>& best) const {
    search(0, static_cast<int>(order_.size()), index, count, best);
    std::sort_heap(best.begin(), best.end());
  }

 private:
  static constexpr int kLeafSize = 8;

  void build(int begin, int end) {
    if (end - begin <= kLeafSize) return;
    Eigen::Vector3d low = points_.col(order_[begin]), high = low;
    for (int i = begin; i < end; ++i) {
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
    if (end - begin <= kLeafSize) {
      for (int i = begin; i < end; ++i) visit(order_[i], index, count, best);
      return;
    }
    const int middle = (begin + end) / 2;
    const int axis = axis_[middle];
    const double side = points_(axis, index) - points_(axis, order_[middle]);
    visit(order_[middle], index, count, best);
    const auto half = [&](bool lower) {
      lower ? search(begin, middle, index, count, best)
            : search(middle + 1, end, index, count, best);
    };
    half(side < 0.0);
    if (best.size() < count || side * side <= best.front().first) half(side >= 0.0);
  }

  Eigen::Matrix3Xd points_;
  std::vector<int> order_;
  std::vector<unsigned char> axis_;
};

}  // namespace

Eigen::MatrixXi nearest_points(const Eigen::MatrixXd& points, int count) {
  const Tree tree(points);
  Eigen::MatrixXi result(points.rows(), count);
  at::parallel_for(0, points.rows(), 512, [&](int64_t begin, int64_t end) {
    std::vector<std::pair<double, int>> best;
    for (int64_t v = begin; v < end; ++v) {
      best.clear();
      tree.nearest(static_cast<int>(v), static_cast<size_t>(count), best);
      for (int i = 0; i < count; ++i) result(v, i) = best[static_cast<size_t>(i)].second;
    }
  });
  return result;
}

}  // namespace freetalk::geometry
