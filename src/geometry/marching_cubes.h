// The cases of marching cubes. Corner 4 x + 2 y + z of a cell lies at the lower (0) or upper (1)
// side of each axis; bit c of a case says that corner c is below the level.
#pragma once

#include <array>
#include <cstdint>

namespace freetalk::geometry {

/// An edge of a cell runs along an axis from its lower corner.
struct CellEdge {
  int corner;
  int axis;  // 0 x, 1 y, 2 z

  int end() const { return corner | 4 >> axis; }
};

/// Axis by axis, lower corners ascending.
constexpr int kCellEdges = 12;

struct CubeCase {
  int triangles = 0;
  std::array<uint8_t, 15> edges{};  // three a triangle
};

struct MarchingCubes {
  std::array<CellEdge, kCellEdges> edges;
  std::array<CubeCase, 256> cases;
};

/// Made at the first call.
const MarchingCubes& marching_cubes();

/// How far along an edge of the grid the level lies, away from the ends by 1e-4: vertices of
/// different edges never coincide.
inline double crossing(float from, float to, double level) {
  const double t = (level - from) / (static_cast<double>(to) - from);
  return t > 1e-4 ? (t < 1.0 - 1e-4 ? t : 1.0 - 1e-4) : 1e-4;
}

}  // namespace freetalk::geometry
