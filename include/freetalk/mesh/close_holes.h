// The rims of a mesh, and lids on them.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <limits>
#include <vector>

namespace freetalk::mesh {

/// The simple loops of edges that only one polygon has, as vertices in the polygons' direction
/// along them, in the order of their first edges. Rims that touch themselves in a vertex are left
/// out.
std::vector<std::vector<int>> boundary_loops(const std::vector<std::vector<int>>& polygons);

/// A mesh with some of its holes closed.
struct ClosedHoles {
  Eigen::MatrixXd vertices;  ///< (V + H, 3): the middle of each closed hole after the mesh's own
  Eigen::MatrixXi faces;     ///< (F', 3): the mesh's own first
  int64_t left = 0;          ///< edges that still have one triangle only
};

/// Closes holes by fans around their middles, which suits rims that are about star-shaped.
/// @param vertices (V, 3). @param faces (F, 3) in range.
/// @param max_edges holes of more edges stay open.
ClosedHoles close_holes(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                        int64_t max_edges = std::numeric_limits<int64_t>::max());

}  // namespace freetalk::mesh
