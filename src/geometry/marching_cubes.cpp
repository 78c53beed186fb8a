#include "geometry/marching_cubes.h"

#include <cstddef>
#include <utility>
#include <vector>

namespace freetalk::geometry {
namespace {

using CellEdges = std::array<CellEdge, kCellEdges>;
using CellFace = std::array<int, 4>;  // corners, counterclockwise from outside

CellEdges cell_edges() {
  CellEdges edges;
  int count = 0;
  for (int axis = 0; axis < 3; ++axis) {
    for (int corner = 0; corner < 8; ++corner) {
      if (!(corner & 4 >> axis)) edges[count++] = {corner, axis};
    }
  }
  return edges;
}

std::array<CellFace, 6> cell_faces() {
  std::array<CellFace, 6> faces;
  for (int axis = 0; axis < 3; ++axis) {
    const int bit = 4 >> axis, u = 4 >> (axis + 1) % 3, v = 4 >> (axis + 2) % 3;
    faces[2 * axis] = {0, v, u | v, u};
    faces[2 * axis + 1] = {bit, bit | u, bit | u | v, bit | v};
  }
  return faces;
}

int edge_between(const CellEdges& edges, int a, int b) {
  int found = 0;
  for (int e = 0; e < kCellEdges; ++e) {
    if (edges[e].corner == (a & b) && edges[e].end() == (a | b)) found = e;
  }
  return found;
}

bool in_one_face(const CellEdges& edges, int a, int b) {
  const int lower = edges[a].corner & edges[a].end() & edges[b].corner & edges[b].end();
  const int upper = edges[a].corner | edges[a].end() | edges[b].corner | edges[b].end();
  return lower != 0 || upper != 7;
}

/// The edge after each crossed edge around the corners below the level, -1 elsewhere: within a
/// face, a run of corners below the level is cut off by one segment.
std::array<int, kCellEdges> segments(const CellEdges& edges, const std::array<CellFace, 6>& faces,
                                     int cube) {
  std::array<int, kCellEdges> next;
  next.fill(-1);
  for (const CellFace& face : faces) {
    const auto below = [&](int i) { return (cube >> face[i % 4] & 1) != 0; };
    const auto edge = [&](int i) { return edge_between(edges, face[i % 4], face[(i + 1) % 4]); };
    for (int i = 0; i < 4; ++i) {
      if (below(i) || !below(i + 1)) continue;
      int last = i + 1;
      while (below(last + 1)) ++last;
      next[edge(i)] = edge(last);
    }
  }
  return next;
}

/// Cuts a polygon into a fan from its first corner whose diagonals all cross the cell's inside
/// (there is one for every polygon of the 256 cases).
void add_fan(const CellEdges& edges, const std::vector<int>& polygon, CubeCase& result) {
  const size_t count = polygon.size();
  const auto at = [&](size_t i) { return polygon[i % count]; };
  size_t first = 0;
  const auto inside = [&](size_t start) {
    for (size_t i = 2; i + 1 < count; ++i) {
      if (in_one_face(edges, at(start), at(start + i))) return false;
    }
    return true;
  };
  while (first + 1 < count && !inside(first)) ++first;
  for (size_t i = 1; i + 1 < count; ++i) {
    uint8_t* triangle = &result.edges[static_cast<size_t>(3 * result.triangles++)];
    triangle[0] = static_cast<uint8_t>(at(first));
    triangle[1] = static_cast<uint8_t>(at(first + i));
    triangle[2] = static_cast<uint8_t>(at(first + i + 1));
  }
}

MarchingCubes generate() {
  MarchingCubes table;
  table.edges = cell_edges();
  const std::array<CellFace, 6> faces = cell_faces();
  for (int cube = 0; cube < 256; ++cube) {
    std::array<int, kCellEdges> next = segments(table.edges, faces, cube);
    for (int start = 0; start < kCellEdges; ++start) {
      std::vector<int> polygon;
      for (int edge = start; next[edge] >= 0;) {
        polygon.push_back(edge);
        edge = std::exchange(next[edge], -1);
      }
      if (!polygon.empty()) add_fan(table.edges, polygon, table.cases[static_cast<size_t>(cube)]);
    }
  }
  return table;
}

}  // namespace

const MarchingCubes& marching_cubes() {
  static const MarchingCubes table = generate();
  return table;
}

}  // namespace freetalk::geometry
