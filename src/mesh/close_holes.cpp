#include "freetalk/mesh/close_holes.h"

#include <algorithm>
#include <map>
#include <utility>

namespace freetalk::mesh {
namespace {

using Edge = std::pair<int, int>;

/// The edges of one polygon only, in the order and direction of the polygons.
std::vector<Edge> boundary_edges(const std::vector<std::vector<int>>& polygons) {
  std::vector<Edge> edges, sorted;
  for (const std::vector<int>& polygon : polygons) {
    for (size_t c = 0; c < polygon.size(); ++c) {
      const int a = polygon[c], b = polygon[(c + 1) % polygon.size()];
      if (a != b) edges.emplace_back(a, b);
    }
  }
  sorted.reserve(edges.size());
  for (const auto& [a, b] : edges) sorted.emplace_back(std::minmax(a, b));
  std::sort(sorted.begin(), sorted.end());
  std::erase_if(edges, [&](const Edge& edge) {
    const auto [first, last] =
        std::equal_range(sorted.begin(), sorted.end(), Edge(std::minmax(edge.first, edge.second)));
    return last - first != 1;
  });
  return edges;
}

}  // namespace

std::vector<std::vector<int>> boundary_loops(const std::vector<std::vector<int>>& polygons) {
  const std::vector<Edge> edges = boundary_edges(polygons);
  std::map<int, int> next, leaving;
  for (const auto& [a, b] : edges) {
    next[a] = b;
    ++leaving[a];
  }
  std::vector<std::vector<int>> loops;
  std::map<int, bool> seen;
  for (const auto& [start, unused] : edges) {
    std::vector<int> loop;
    int at = start;
    while (!seen[at] && leaving[at] == 1) {
      seen[at] = true;
      loop.push_back(at);
      at = next[at];
    }
    if (!loop.empty() && at == start) loops.push_back(std::move(loop));
  }
  return loops;
}

ClosedHoles close_holes(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                        int64_t max_edges) {
  std::vector<std::vector<int>> polygons(static_cast<size_t>(faces.rows()));
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    polygons[static_cast<size_t>(f)] = {faces(f, 0), faces(f, 1), faces(f, 2)};
  }
  std::vector<std::vector<int>> loops = boundary_loops(polygons);
  int64_t open = static_cast<int64_t>(boundary_edges(polygons).size());
  std::erase_if(loops,
                [&](const auto& loop) { return static_cast<int64_t>(loop.size()) > max_edges; });
  int64_t added = 0;
  for (const auto& loop : loops) added += static_cast<int64_t>(loop.size());
  const auto holes = static_cast<Eigen::Index>(loops.size());
  ClosedHoles closed{Eigen::MatrixXd(vertices.rows() + holes, 3),
                     Eigen::MatrixXi(faces.rows() + added, 3), open - added};
  closed.vertices.topRows(vertices.rows()) = vertices;
  closed.faces.topRows(faces.rows()) = faces;
  Eigen::Index face = faces.rows(), center = vertices.rows();
  for (const std::vector<int>& loop : loops) {
    Eigen::RowVector3d middle = Eigen::RowVector3d::Zero();
    for (size_t i = 0; i < loop.size(); ++i) {
      middle += vertices.row(loop[i]);
      closed.faces.row(face++) << loop[(i + 1) % loop.size()], loop[i], static_cast<int>(center);
    }
    closed.vertices.row(center++) = middle / static_cast<double>(loop.size());
  }
  return closed;
}

}  // namespace freetalk::mesh
