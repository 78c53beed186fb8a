// Areas and normals of triangle meshes. V (V, 3) double, F (F, 3) int; faces may be degenerate,
// repeated, non-manifold; vertices unreferenced.
#pragma once

#include <Eigen/Core>

namespace freetalk::mesh {

/// (3,) normal of a face, as long as twice its area.
Eigen::Vector3d area_vector(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                            Eigen::Index face);

/// (F,) areas.
Eigen::VectorXd face_areas(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces);

/// (F, 3) unit normals; zero for degenerate faces.
Eigen::MatrixXd face_normals(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces);

/// (V, 3) unit normals, the unweighted mean of the unit normals of the faces around; +Z where there
/// is none.
Eigen::MatrixXd vertex_normals(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces);

/// (V, 3) unit means of the vectors (F, 3) of the faces around each vertex; +Z where there is none.
Eigen::MatrixXd mean_normals(const Eigen::MatrixXd& of_faces, const Eigen::MatrixXi& faces,
                             Eigen::Index num_vertices);

}  // namespace freetalk::mesh
