// Joins what a file keeps apart: coincident vertices along texture seams and in triangle soups, and
// fragments of a few faces, as tears leave them. Each would be a component of its own to a
// Laplacian and take an eigenpair of eigenvalue zero from the surface.
#pragma once

#include <Eigen/Core>

#include <string>

namespace freetalk::mesh {

/// A surface with fewer vertices, and where each vertex of the original went.
struct WeldedSurface {
  Eigen::MatrixXd vertices;   ///< (W, 3)
  Eigen::MatrixXi faces;      ///< (F', 3); faces that collapsed are gone
  Eigen::VectorXi vertex_of;  ///< (V,) welded vertex of each original one, onto 0 .. W - 1
};

/// When vertices at the same position are the same vertex.
struct SameVertex {
  double min_cosine = -0.5;  ///< between their normals; what turns further is another side
  bool on_borders = false;   ///< only vertices on open borders, as those along seams are
};

/// (V,) the first vertex of the same position and side of the surface; itself where it is the first
/// or no face refers to it. @param vertices (V, 3). @param faces (F, 3) in range.
Eigen::VectorXi first_of_same(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                              const SameVertex& same = {});

/// @throws std::invalid_argument for another mode than those of weld().
void check_weld(const std::string& mode);

/// Welds a surface.
///
/// "coincident": vertices at the same position become one, unless that would close a mouth or an
/// eye: vertices whose normals point apart (more than 120 degrees) stay two.
/// "fragments": that, and every component of at most max(8, W / 500) vertices, unreferenced
/// vertices included, is laid onto the nearest vertices of the rest. Its faces are kept where all
/// corners lie within half a mean edge of what they are laid onto. A surface of fragments alone
/// stays as it is.
/// "none": the surface as it is.
///
/// @param vertices (V, 3). @param faces (F, 3) in range.
/// @throws std::invalid_argument for another mode.
WeldedSurface weld(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                   const std::string& mode);

}  // namespace freetalk::mesh
