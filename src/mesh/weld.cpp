#include "freetalk/mesh/weld.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "freetalk/core/error.h"
#include "freetalk/mesh/components.h"
#include "freetalk/mesh/normals.h"
#include "mesh/kd_tree.h"

namespace freetalk::mesh {
namespace {

std::vector<char> referenced_vertices(Eigen::Index count, const Eigen::MatrixXi& faces) {
  std::vector<char> referenced(static_cast<size_t>(count), 0);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int c = 0; c < 3; ++c) referenced[faces(f, c)] = 1;
  }
  return referenced;
}

/// Renumbers representatives (V,) to 0 .. W - 1 and carries vertices and faces over.
WeldedSurface collapse(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                       const Eigen::VectorXi& representative) {
  WeldedSurface result;
  std::vector<int> number(static_cast<size_t>(representative.size()), -1);
  std::vector<int> kept;
  for (int v = 0; v < static_cast<int>(representative.size()); ++v) {
    if (representative[v] != v) continue;
    number[v] = static_cast<int>(kept.size());
    kept.push_back(v);
  }
  result.vertices.resize(static_cast<Eigen::Index>(kept.size()), 3);
  for (size_t w = 0; w < kept.size(); ++w) {
    result.vertices.row(static_cast<Eigen::Index>(w)) = vertices.row(kept[w]);
  }
  result.vertex_of.resize(vertices.rows());
  for (Eigen::Index v = 0; v < representative.size(); ++v) {
    result.vertex_of[v] = number[representative[v]];
  }
  Eigen::Index used = 0;
  result.faces.resize(faces.rows(), 3);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    Eigen::RowVector3i corner;
    for (int c = 0; c < 3; ++c) corner[c] = result.vertex_of[faces(f, c)];
    const bool was_whole =
        faces(f, 0) != faces(f, 1) && faces(f, 1) != faces(f, 2) && faces(f, 2) != faces(f, 0);
    const bool is_whole =
        corner[0] != corner[1] && corner[1] != corner[2] && corner[2] != corner[0];
    if (is_whole || !was_whole) result.faces.row(used++) = corner;
  }
  result.faces.conservativeResize(used, 3);
  return result;
}

/// The vertices of edges that one triangle alone has.
std::vector<char> border_vertices(Eigen::Index count, const Eigen::MatrixXi& faces) {
  std::vector<std::pair<int, int>> edges;
  edges.reserve(static_cast<size_t>(3 * faces.rows()));
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int c = 0; c < 3; ++c) edges.push_back(std::minmax({faces(f, c), faces(f, (c + 1) % 3)}));
  }
  std::sort(edges.begin(), edges.end());
  std::vector<char> border(static_cast<size_t>(count), 0);
  for (size_t begin = 0, end = 0; begin < edges.size(); begin = end) {
    while (end < edges.size() && edges[end] == edges[begin]) ++end;
    if (end - begin == 1) border[edges[begin].first] = border[edges[begin].second] = 1;
  }
  return border;
}

double mean_edge(const WeldedSurface& surface, const std::vector<char>& kept) {
  double sum = 0.0;
  int64_t count = 0;
  for (Eigen::Index f = 0; f < surface.faces.rows(); ++f) {
    if (!kept[surface.faces(f, 0)]) continue;
    for (int c = 0; c < 3; ++c) {
      sum += (surface.vertices.row(surface.faces(f, c)) -
              surface.vertices.row(surface.faces(f, (c + 1) % 3)))
                 .norm();
      ++count;
    }
  }
  return count > 0 ? sum / static_cast<double>(count) : 0.0;
}

/// Whether each vertex belongs to a component that is large enough to stand for itself.
std::vector<char> large_components(const WeldedSurface& surface) {
  const Eigen::Index count = surface.vertices.rows();
  const Eigen::VectorXi component = connected_components(count, surface.faces);
  std::vector<Eigen::Index> size(static_cast<size_t>(component.maxCoeff()) + 1, 0);
  for (Eigen::Index w = 0; w < count; ++w) ++size[component[w]];
  const Eigen::Index limit = std::max<Eigen::Index>(8, count / 500);
  std::vector<char> large(static_cast<size_t>(count));
  for (Eigen::Index w = 0; w < count; ++w) large[w] = size[component[w]] > limit;
  return large;
}

/// Lays every vertex that is not `kept` onto the nearest one that is.
WeldedSurface lay_onto(const WeldedSurface& surface, const std::vector<char>& kept) {
  const Eigen::Index count = surface.vertices.rows();
  std::vector<int> ground;
  for (int w = 0; w < static_cast<int>(count); ++w) {
    if (kept[w]) ground.push_back(w);
  }
  Eigen::Matrix3Xd points(3, static_cast<Eigen::Index>(ground.size()));
  for (size_t i = 0; i < ground.size(); ++i) {
    points.col(static_cast<Eigen::Index>(i)) = surface.vertices.row(ground[i]).transpose();
  }
  const KdTree tree(points);
  const double reach = 0.5 * mean_edge(surface, kept);
  Eigen::VectorXi representative =
      Eigen::VectorXi::LinSpaced(count, 0, static_cast<int>(count) - 1);
  std::vector<char> near(static_cast<size_t>(count), 1);
  for (Eigen::Index w = 0; w < count; ++w) {
    if (kept[w]) continue;
    const Neighbour found = tree.nearest(surface.vertices.row(w).transpose(), 1).front();
    representative[w] = ground[found.index];
    near[w] = found.distance <= reach;
  }
  Eigen::MatrixXi faces(surface.faces.rows(), 3);
  Eigen::Index used = 0;
  for (Eigen::Index f = 0; f < surface.faces.rows(); ++f) {
    const auto corner = surface.faces.row(f);
    if (near[corner[0]] && near[corner[1]] && near[corner[2]]) faces.row(used++) = corner;
  }
  faces.conservativeResize(used, 3);
  WeldedSurface result = collapse(surface.vertices, faces, representative);
  Eigen::VectorXi through(surface.vertex_of.size());
  for (Eigen::Index v = 0; v < through.size(); ++v) {
    through[v] = result.vertex_of[surface.vertex_of[v]];
  }
  result.vertex_of = through;
  return result;
}

}  // namespace

Eigen::VectorXi first_of_same(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                              const SameVertex& same) {
  const Eigen::VectorXi first = coincident_vertices(vertices);
  const Eigen::MatrixXd normals = vertex_normals(vertices, faces);
  const std::vector<char> asked = same.on_borders ? border_vertices(vertices.rows(), faces)
                                                  : referenced_vertices(vertices.rows(), faces);
  const int count = static_cast<int>(vertices.rows());
  Eigen::VectorXi representative = Eigen::VectorXi::LinSpaced(count, 0, count - 1);
  std::vector<std::vector<int>> sides(
      static_cast<size_t>(count));  // Of a spot, at its first vertex.
  for (int v = 0; v < count; ++v) {
    if (!asked[v]) continue;
    std::vector<int>& known = sides[first[v]];
    const auto side = std::find_if(known.begin(), known.end(), [&](int other) {
      return normals.row(v).dot(normals.row(other)) > same.min_cosine;
    });
    if (side == known.end()) {
      known.push_back(v);
    } else {
      representative[v] = *side;
    }
  }
  return representative;
}

void check_weld(const std::string& mode) {
  FREETALK_CHECK(mode == "none" || mode == "coincident" || mode == "fragments",
                 "weld must be \"none\", \"coincident\" or \"fragments\", found \"", mode, "\"");
}

WeldedSurface weld(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                   const std::string& mode) {
  check_weld(mode);
  if (mode == "none") {
    return {vertices, faces,
            Eigen::VectorXi::LinSpaced(vertices.rows(), 0, static_cast<int>(vertices.rows()) - 1)};
  }
  WeldedSurface welded = collapse(vertices, faces, first_of_same(vertices, faces));
  if (mode == "coincident") return welded;
  const std::vector<char> large = large_components(welded);
  const auto count = std::count(large.begin(), large.end(), char{1});
  if (count == 0 || count == static_cast<std::ptrdiff_t>(large.size())) return welded;
  return lay_onto(welded, large);
}

}  // namespace freetalk::mesh
