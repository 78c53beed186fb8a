// Marching cubes: the surface of a level of a scalar field as a triangle mesh. The 256 cases are
// generated, a face of a cell whose corners alternate is always cut so that the corners below the
// level are apart, and no diagonal of a polygon lies in a face of its cell. So cells agree along
// common faces, and the mesh is manifold; its only borders lie where the cells end (Lorensen &
// Cline 1987; Dürst 1988 on ambiguous faces). Faces turn towards larger values: outward for a
// signed distance that is negative inside.
#pragma once

#include <Eigen/Core>

#include <array>
#include <cstdint>

namespace freetalk::geometry {

/// A triangle mesh; the same bits for any number of threads.
struct Isosurface {
  Eigen::MatrixXd vertices;  ///< (V, 3), one for each edge of the grid that crosses the level
  Eigen::MatrixXi faces;     ///< (F, 3)
};

struct IsosurfaceOptions {
  double level = 0.0;                                      ///< the value of the surface
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();        ///< place of values[0, 0, 0]
  Eigen::Vector3d spacing = Eigen::Vector3d::Constant(1);  ///< between neighbours of each axis, > 0
};

/// The surface of a field on a regular grid. NaN counts as above the level.
/// @param values (X, Y, Z) float32, z fastest. @param shape X, Y, Z, each at least 2.
/// @throws std::invalid_argument for another shape or spacing.
Isosurface isosurface(const float* values, const std::array<int64_t, 3>& shape,
                      const IsosurfaceOptions& options = {});

/// Corners of cells: corner 4 x + 2 y + z lies at the lower (0) or upper (1) side of each axis.
using CellCorners = Eigen::Matrix<int, Eigen::Dynamic, 8, Eigen::RowMajor>;

/// The surface of a field within chosen cells of one grid, as an octree leaves them. Cells that
/// cross the level and are left out leave a border.
/// @param corners (P, 3) places, each once. @param values (P,) of the field there.
/// @param cells (N, 8) rows of `corners`. @throws std::invalid_argument for rows out of range.
Isosurface isosurface_of_cells(const Eigen::MatrixXd& corners, const Eigen::VectorXf& values,
                               const CellCorners& cells, double level = 0.0);

}  // namespace freetalk::geometry
