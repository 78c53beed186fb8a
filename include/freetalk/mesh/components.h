// What belongs together in a mesh: connected components, vertices at one place.
#pragma once

#include <Eigen/Core>

#include <cstdint>

namespace freetalk::mesh {

/// (V,) component of each vertex, numbered in order of first vertex; an unreferenced vertex is its
/// own.
Eigen::VectorXi connected_components(int64_t num_vertices, const Eigen::MatrixXi& faces);

/// (V,) for each vertex the first one at the same position (itself if there is none before).
Eigen::VectorXi coincident_vertices(const Eigen::MatrixXd& vertices);

}  // namespace freetalk::mesh
