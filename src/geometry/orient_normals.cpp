#include <algorithm>
#include <cmath>
#include <numeric>
#include <queue>
#include <tuple>
#include <vector>

#include "freetalk/geometry/robust_laplacian.h"

namespace freetalk::geometry {
namespace {

/// Neighbours both ways: the graph of the nearest points is not symmetric.
std::vector<std::vector<int>> symmetric_graph(const Eigen::MatrixXi& neighbors) {
  std::vector<std::vector<int>> graph(static_cast<size_t>(neighbors.rows()));
  for (Eigen::Index v = 0; v < neighbors.rows(); ++v) {
    for (const int w : neighbors.row(v)) {
      graph[static_cast<size_t>(v)].push_back(w);
      graph[static_cast<size_t>(w)].push_back(static_cast<int>(v));
    }
  }
  return graph;
}

}  // namespace

void orient_normals(const Eigen::MatrixXd& points, const Eigen::MatrixXi& neighbors,
                    Eigen::MatrixXd& normals) {
  const auto count = static_cast<size_t>(points.rows());
  const std::vector<std::vector<int>> graph = symmetric_graph(neighbors);
  const Eigen::RowVector3d center = points.colwise().mean();
  const Eigen::VectorXd distance = (points.rowwise() - center).rowwise().squaredNorm();
  std::vector<int> outermost(count);
  std::iota(outermost.begin(), outermost.end(), 0);
  std::stable_sort(outermost.begin(), outermost.end(),
                   [&](int a, int b) { return distance[a] > distance[b]; });
  std::vector<char> done(count, 0);
  using Step = std::tuple<double, int, int>;  // 1 - |cosine|, to, from
  std::priority_queue<Step, std::vector<Step>, std::greater<>> steps;
  for (const int seed : outermost) {
    if (done[seed]) continue;
    if (normals.row(seed).dot(points.row(seed) - center) < 0.0) normals.row(seed) *= -1.0;
    steps.emplace(0.0, seed, seed);
    while (!steps.empty()) {
      const auto [cost, to, from] = steps.top();
      steps.pop();
      if (done[to]) continue;
      done[to] = 1;
      if (normals.row(to).dot(normals.row(from)) < 0.0) normals.row(to) *= -1.0;
      for (const int next : graph[static_cast<size_t>(to)]) {
        if (!done[next]) {
          steps.emplace(1.0 - std::abs(normals.row(next).dot(normals.row(to))), next, to);
        }
      }
    }
  }
}

}  // namespace freetalk::geometry
