#include "freetalk/mesh/normals.h"

#include <Eigen/Geometry>

namespace freetalk::mesh {

Eigen::Vector3d area_vector(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                            Eigen::Index face) {
  const Eigen::Vector3d a = vertices.row(faces(face, 0));
  const Eigen::Vector3d b = vertices.row(faces(face, 1));
  const Eigen::Vector3d c = vertices.row(faces(face, 2));
  return (b - a).cross(c - a);
}

Eigen::VectorXd face_areas(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces) {
  Eigen::VectorXd areas(faces.rows());
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    areas[f] = 0.5 * area_vector(vertices, faces, f).norm();
  }
  return areas;
}

Eigen::MatrixXd face_normals(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces) {
  Eigen::MatrixXd normals(faces.rows(), 3);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    normals.row(f) = area_vector(vertices, faces, f).stableNormalized();
  }
  return normals;
}

Eigen::MatrixXd mean_normals(const Eigen::MatrixXd& of_faces, const Eigen::MatrixXi& faces,
                             Eigen::Index num_vertices) {
  Eigen::MatrixXd normals = Eigen::MatrixXd::Zero(num_vertices, 3);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int c = 0; c < 3; ++c) normals.row(faces(f, c)) += of_faces.row(f);
  }
  for (Eigen::Index v = 0; v < normals.rows(); ++v) {
    const double norm = normals.row(v).norm();
    constexpr double kCancelled = 1e-9;  // Opposite faces: what is left is rounding.
    if (norm > kCancelled) {
      normals.row(v) /= norm;
    } else {
      normals.row(v) = Eigen::RowVector3d::UnitZ();
    }
  }
  return normals;
}

Eigen::MatrixXd vertex_normals(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces) {
  return mean_normals(face_normals(vertices, faces), faces, vertices.rows());
}

}  // namespace freetalk::mesh
