#include "freetalk/mesh/weld.h"

#include <algorithm>
#include <limits>
#include <numeric>
#include <vector>

#include "freetalk/core/error.h"
#include "freetalk/mesh/components.h"
#include "freetalk/mesh/normals.h"
#include "mesh/kd_tree.h"

namespace freetalk::mesh {
namespace {

/// Cosine between the normals of coincident vertices above which they are one.
constexpr double kSameSide = -0.5;

std::vector<char> referenced_vertices(Eigen::Index count, const Eigen::MatrixXi& faces) {
  std::vector<char> referenced(static_cast<size_t>(count), 0);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int c = 0; c < 3; ++c) referenced[faces(f, c)] = 1;
  }
  return referenced;
}

/// Renumbers representatives (V,) to 0 .. W - 1 and carries vertices and faces over.
WeldedSurface collapse(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                       const std::vector<int>& representative) {
  WeldedSurface result;
  std::vector<int> number(representative.size(), -1);
  std::vector<int> kept;
  for (size_t v = 0; v < representative.size(); ++v) {
    if (representative[v] != static_cast<int>(v)) continue;
    number[v] = static_cast<int>(kept.size());
    kept.push_back(static_cast<int>(v));
  }
  result.vertices.resize(static_cast<Eigen::Index>(kept.size()), 3);
  for (size_t w = 0; w < kept.size(); ++w) {
    result.vertices.row(static_cast<Eigen::Index>(w)) = vertices.row(kept[w]);
  }
  result.vertex_of.resize(vertices.rows());
  for (size_t v = 0; v < representative.size(); ++v) {
    result.vertex_of[static_cast<Eigen::Index>(v)] = number[representative[v]];
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

/// The first vertex on the same spot and side of the surface, for each vertex.
std::vector<int> same_spot(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces) {
  const Eigen::VectorXi first = coincident_vertices(vertices);
  const Eigen::MatrixXd normals = vertex_normals(vertices, faces);
  const std::vector<char> referenced = referenced_vertices(vertices.rows(), faces);
  std::vector<int> representative(static_cast<size_t>(vertices.rows()));
  std::iota(representative.begin(), representative.end(), 0);
  std::vector<std::vector<int>> sides(representative.size());  // Of a spot, at its first vertex.
  for (int v = 0; v < static_cast<int>(vertices.rows()); ++v) {
    if (!referenced[v]) continue;
    std::vector<int>& known = sides[first[v]];
    const auto side = std::find_if(known.begin(), known.end(), [&](int other) {
      return normals.row(v).dot(normals.row(other)) > kSameSide;
    });
    if (side == known.end()) {
      known.push_back(v);
    } else {
      representative[v] = *side;
    }
  }
  return representative;
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
  const Eigen::Matrix3Xd no_normals = Eigen::Matrix3Xd::Zero(3, points.cols());
  const KdTree tree(points, no_normals);
  const double reach = 0.5 * mean_edge(surface, kept);
  std::vector<int> representative(static_cast<size_t>(count));
  std::iota(representative.begin(), representative.end(), 0);
  std::vector<char> near(static_cast<size_t>(count), 1);
  for (Eigen::Index w = 0; w < count; ++w) {
    if (kept[w]) continue;
    const Eigen::Vector3d point = surface.vertices.row(w).transpose();
    const int found = tree.nearest(point, Eigen::Vector3d::Zero(),
                                   std::numeric_limits<double>::infinity(), -2.0, 0.0);
    representative[w] = ground[found];
    near[w] = (surface.vertices.row(ground[found]) - surface.vertices.row(w)).norm() <= reach;
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
  WeldedSurface welded = collapse(vertices, faces, same_spot(vertices, faces));
  if (mode == "coincident") return welded;
  const std::vector<char> large = large_components(welded);
  const auto count = std::count(large.begin(), large.end(), char{1});
  if (count == 0 || count == static_cast<std::ptrdiff_t>(large.size())) return welded;
  return lay_onto(welded, large);
}

}  // namespace freetalk::mesh
