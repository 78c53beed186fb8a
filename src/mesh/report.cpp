#include "freetalk/mesh/report.h"

#include <Eigen/Geometry>

#include <algorithm>
#include <limits>
#include <tuple>

#include "freetalk/core/error.h"
#include "freetalk/mesh/components.h"
#include "freetalk/mesh/normals.h"
#include "mesh/union_find.h"

namespace freetalk::mesh {
namespace {

/// One side of a polygon, a loop where it names a vertex twice in a row: it leaves corner `corner`
/// (numbered over all polygons) for `next_corner`.
struct Side {
  int low, high;  // vertices
  int corner, next_corner;
  bool forward;  // from low to high

  bool same_edge(const Side& other) const { return low == other.low && high == other.high; }
};

/// The sides of all polygons, those of an edge together; and the vertex of each corner.
std::vector<Side> sorted_sides(const Mesh& mesh, std::vector<int>& corner_vertex) {
  std::vector<Side> sides;
  for (int64_t p = 0; p < mesh.num_polygons(); ++p) {
    const std::vector<int> polygon = mesh.polygon(p);
    const auto first = static_cast<int>(corner_vertex.size());
    const auto count = static_cast<int>(polygon.size());
    corner_vertex.insert(corner_vertex.end(), polygon.begin(), polygon.end());
    for (int c = 0; c < count; ++c) {
      const int a = polygon[c], b = polygon[(c + 1) % count];
      sides.push_back({std::min(a, b), std::max(a, b), first + c, first + (c + 1) % count, a < b});
    }
  }
  std::sort(sides.begin(), sides.end(), [](const Side& a, const Side& b) {
    return std::tie(a.low, a.high, a.corner) < std::tie(b.low, b.high, b.corner);
  });
  return sides;
}

/// Edges, boundaries, orientation, and vertices whose corners no edge connects.
void count_edges(const Mesh& mesh, MeshReport& report) {
  std::vector<int> corner_vertex;
  const std::vector<Side> sides = sorted_sides(mesh, corner_vertex);
  UnionFind fans(corner_vertex.size());
  UnionFind rims(static_cast<size_t>(mesh.num_vertices()));
  std::vector<int> rim_vertices;
  const auto corner_at = [](const Side& side, bool low) {
    return side.forward == low ? side.corner : side.next_corner;
  };
  for (size_t begin = 0, end = 0; begin < sides.size(); begin = end) {
    while (end < sides.size() && sides[end].same_edge(sides[begin])) ++end;
    if (sides[begin].low == sides[begin].high) {  // Of polygons that name a vertex twice.
      for (size_t i = begin; i < end; ++i) fans.join(sides[i].corner, sides[i].next_corner);
      continue;
    }
    ++report.edges;
    const size_t count = end - begin;
    if (count == 1) {
      ++report.boundary_edges;
      rims.join(sides[begin].low, sides[begin].high);
      rim_vertices.push_back(sides[begin].low);
    }
    if (count > 2) ++report.nonmanifold_edges;
    if (count == 2 && sides[begin].forward == sides[begin + 1].forward) ++report.inconsistent_edges;
    for (size_t i = begin + 1; i < end; ++i) {
      for (const bool low : {true, false}) {
        fans.join(corner_at(sides[begin], low), corner_at(sides[i], low));
      }
    }
  }
  std::sort(rim_vertices.begin(), rim_vertices.end(),
            [&](int a, int b) { return rims.root(a) < rims.root(b); });
  for (size_t i = 0; i < rim_vertices.size(); ++i) {
    if (i == 0 || rims.root(rim_vertices[i]) != rims.root(rim_vertices[i - 1])) ++report.boundaries;
  }
  std::vector<int> fans_at(static_cast<size_t>(mesh.num_vertices()), 0);
  for (int corner = 0; corner < static_cast<int>(corner_vertex.size()); ++corner) {
    if (fans.root(corner) == corner) ++fans_at[corner_vertex[corner]];
  }
  for (const int count : fans_at) report.nonmanifold_vertices += count > 1;
}

void count_polygons(const Mesh& mesh, MeshReport& report) {
  std::vector<std::vector<int>> sorted(static_cast<size_t>(mesh.num_polygons()));
  for (int64_t p = 0; p < mesh.num_polygons(); ++p) {
    std::vector<int>& polygon = sorted[static_cast<size_t>(p)] = mesh.polygon(p);
    report.larger_polygons += polygon.size() > 3;
    std::sort(polygon.begin(), polygon.end());
    report.repeated_corner_polygons +=
        std::adjacent_find(polygon.begin(), polygon.end()) != polygon.end();
  }
  std::sort(sorted.begin(), sorted.end());
  for (size_t i = 1; i < sorted.size(); ++i) {
    report.duplicate_polygons += sorted[i] == sorted[i - 1];
  }
}

void count_triangles(const Mesh& mesh, MeshReport& report) {
  constexpr double kThin = 1e-6;
  const Eigen::VectorXd areas = face_areas(mesh.vertices, mesh.faces);
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) {
    double longest = 0.0;
    for (int c = 0; c < 3; ++c) {
      longest = std::max(longest, (mesh.vertices.row(mesh.faces(f, c)) -
                                   mesh.vertices.row(mesh.faces(f, (c + 1) % 3)))
                                      .squaredNorm());
    }
    report.zero_area_triangles += !(2.0 * areas[f] > kThin * longest);
  }
}

void count_vertices(const Mesh& mesh, MeshReport& report) {
  std::vector<char> used(static_cast<size_t>(mesh.num_vertices()), 0);
  for (const int v : mesh.faces.reshaped()) used[v] = 1;
  report.unreferenced_vertices = std::count(used.begin(), used.end(), 0);
  const Eigen::VectorXi parts = connected_components(mesh.num_vertices(), mesh.faces);
  std::vector<int> seen;
  constexpr double kNone = std::numeric_limits<double>::infinity();
  Eigen::RowVector3d low = Eigen::RowVector3d::Constant(kNone), high = -low;
  for (Eigen::Index v = 0; v < mesh.num_vertices(); ++v) {
    if (!used[v]) continue;
    seen.push_back(parts[v]);
    low = low.cwiseMin(mesh.vertices.row(v));
    high = high.cwiseMax(mesh.vertices.row(v));
  }
  if (!seen.empty()) report.extent = high - low;
  std::sort(seen.begin(), seen.end());
  report.parts = std::unique(seen.begin(), seen.end()) - seen.begin();
  const Eigen::VectorXi first = coincident_vertices(mesh.vertices);
  for (Eigen::Index v = 0; v < first.size(); ++v) report.coincident_vertices += first[v] != v;
}

}  // namespace

MeshReport mesh_report(const Mesh& mesh) {
  MeshReport report;
  report.vertices = mesh.num_vertices();
  report.polygons = mesh.num_polygons();
  report.triangles = mesh.num_faces();
  report.lines_and_points = mesh.lines_and_points;
  count_vertices(mesh, report);
  count_polygons(mesh, report);
  count_triangles(mesh, report);
  count_edges(mesh, report);
  return report;
}

std::vector<std::string> MeshReport::findings() const {
  std::vector<std::string> lines;
  if (zero_area_triangles == triangles) {
    lines.emplace_back("all faces are as thin as lines: there is no surface to animate");
  }
  const auto add = [&lines](int64_t count, const char* what, const char* advice) {
    if (count > 0) lines.push_back(core::join(count, " ", what, ": ", advice));
  };
  add(nonmanifold_edges, "edges with three or more faces",
      "kept; the \"robust\" Laplacian is made for them");
  add(nonmanifold_vertices, "vertices where surfaces touch in a point only",
      "kept; motion spreads through them");
  add(inconsistent_edges, "edges whose two faces turn opposite ways",
      "normals are wrong there; recalculate them in a mesh editor");
  add(repeated_corner_polygons, "faces that name a vertex twice", "kept; they have no area");
  add(zero_area_triangles, "triangles without area",
      "kept; the \"robust\" Laplacian copes with them, a cleanup in a mesh editor removes them");
  add(duplicate_polygons, "faces that are there already", "kept; they count twice");
  add(coincident_vertices, "vertices at the place of another",
      "seams of textures or tears; kept apart in the output");
  add(unreferenced_vertices, "vertices in no face", "kept; they belong to no surface");
  add(lines_and_points, "lines or points", "not faces: left out");
  if (parts > 1) add(parts, "parts", "motion does not pass from one to another");
  return lines;
}

}  // namespace freetalk::mesh
