#include "stm/lip_sides.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <functional>
#include <limits>
#include <queue>
#include <utility>
#include <vector>

#include "freetalk/core/conventions.h"
#include "freetalk/mesh/weld.h"

namespace freetalk::stm {
namespace {

constexpr double kRegion = 0.06;  // m around the mouth in which ways are looked for
// A way over the surface leads around the mouth if it is longer than the straight one by so much.
constexpr double kDetour = 1.5, kDetourPlus = 0.003;  // times, and m

/// Lengths of ways over the edges of a surface near the mouth.
class Ways {
 public:
  Ways(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
       const Eigen::RowVector3d& mouth)
      : surface_(mesh::weld(vertices, faces, "coincident")),
        near_((surface_.vertices.rowwise() - mouth).rowwise().norm().array() < kRegion),
        next_(static_cast<size_t>(surface_.vertices.rows())) {
    for (const auto& face : surface_.faces.rowwise()) {
      for (int k = 0; k < 3; ++k) {
        const int a = face[k], b = face[(k + 1) % 3];
        if (!near_[a] || !near_[b]) continue;
        next_[static_cast<size_t>(a)].push_back(b);
        next_[static_cast<size_t>(b)].push_back(a);
      }
    }
  }

  /// (V,) whether the way there from the nearest of some vertices is about straight.
  std::vector<bool> straight_from(const std::vector<int>& sources) const {
    const Eigen::MatrixXd& points = surface_.vertices;
    Eigen::VectorXd way =
        Eigen::VectorXd::Constant(points.rows(), std::numeric_limits<double>::infinity());
    using Step = std::pair<double, int>;
    std::priority_queue<Step, std::vector<Step>, std::greater<>> queue;
    for (const int source : sources)
      queue.emplace(way[surface_.vertex_of[source]] = 0, surface_.vertex_of[source]);
    while (!queue.empty()) {
      const auto [length, at] = queue.top();
      queue.pop();
      if (length > way[at]) continue;
      for (const int other : next_[static_cast<size_t>(at)]) {
        const double total = length + (points.row(other) - points.row(at)).norm();
        if (total >= way[other]) continue;
        queue.emplace(way[other] = total, other);
      }
    }
    std::vector<bool> result(static_cast<size_t>(surface_.vertex_of.size()));
    for (size_t v = 0; v < result.size(); ++v) {
      const int at = surface_.vertex_of[static_cast<Eigen::Index>(v)];
      if (!near_[at]) continue;
      double straight = std::numeric_limits<double>::infinity();
      for (const int source : sources) {
        const auto& from = points.row(surface_.vertex_of[source]);
        straight = std::min(straight, (points.row(at) - from).norm());
      }
      result[v] = way[at] <= kDetour * straight + kDetourPlus;
    }
    return result;
  }

 private:
  mesh::WeldedSurface surface_;
  Eigen::Array<bool, Eigen::Dynamic, 1> near_;
  std::vector<std::vector<int>> next_;
};

}  // namespace

void put_on_their_lips(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                       const Eigen::MatrixXd& landmarks, const Eigen::MatrixXd& normals,
                       geometry::SurfacePoints& places) {
  const Ways ways(vertices, faces, landmarks.middleRows(48, 20).colwise().mean());
  for (const auto& lip : {core::kUpperLip, core::kLowerLip}) {
    std::vector<int> outer, inner;
    for (const auto& [landmark, pair] : lip) {
      landmark < core::kFirstInnerLip ? outer.push_back(places.corners(landmark, 0))
                                      : inner.push_back(landmark);
    }
    const std::vector<bool> reached = ways.straight_from(outer);
    const auto lies_there = [&](const auto& corners) {
      for (const int v : corners) {
        if (!reached[static_cast<size_t>(v)]) return false;
      }
      return true;
    };
    std::erase_if(inner, [&](int n) { return lies_there(places.corners.row(n)); });
    if (inner.empty()) continue;
    std::vector<Eigen::Index> own;
    for (Eigen::Index f = 0; f < faces.rows(); ++f) {
      if (lies_there(faces.row(f))) own.push_back(f);
    }
    if (own.empty()) continue;
    const auto moved = geometry::nearest_on_surface(
        vertices, faces(own, Eigen::all), landmarks(inner, Eigen::all), normals(inner, Eigen::all));
    places.corners(inner, Eigen::all) = moved.corners;
    places.shares(inner, Eigen::all) = moved.shares;
    places.distance(inner) = moved.distance;
  }
}

std::vector<bool> upper_side(const at::Tensor& weights, std::span<const std::array<int, 2>> pairs) {
  const auto of = weights.accessor<float, 2>();
  std::vector<bool> upper(static_cast<size_t>(of.size(0)));
  for (int64_t v = 0; v < of.size(0); ++v) {
    float best[2] = {0, 0};
    for (const auto& pair : pairs) {
      for (size_t side = 0; side < 2; ++side) {
        best[side] = std::max(best[side], of[v][pair[side]]);
      }
    }
    upper[static_cast<size_t>(v)] = best[0] > best[1];
  }
  return upper;
}

}  // namespace freetalk::stm
