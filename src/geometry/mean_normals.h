// Vertex normals of face normals.
#pragma once

#include <Eigen/Core>

namespace freetalk::geometry {

/// (V, 3) unit means of the vectors (F, 3) of the faces around each vertex; +Z where there is none.
Eigen::MatrixXd mean_normals(const Eigen::MatrixXd& of_faces, const Eigen::MatrixXi& faces,
                             Eigen::Index num_vertices);

}  // namespace freetalk::geometry
