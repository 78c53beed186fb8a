#include <Eigen/Geometry>

#include <algorithm>
#include <random>

#include "freetalk/core/error.h"
#include "freetalk/geometry/alignment.h"
#include "freetalk/geometry/surface.h"
#include "freetalk/mesh/normals.h"

namespace freetalk::geometry {

SurfaceSamples sample_surface(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                              int64_t num_points, uint64_t seed) {
  FREETALK_CHECK(num_points >= 1, "num_points must be at least 1, found ", num_points);
  const Eigen::VectorXd areas = mesh::face_areas(vertices, faces);
  const double total = areas.sum();
  FREETALK_CHECK(std::isfinite(total) && total > 0.0,
                 "a surface to sample needs faces with an area; all faces have zero area");
  const Eigen::MatrixXd normals = mesh::vertex_normals(vertices, faces);
  std::mt19937_64 generator(seed);
  const auto uniform = [&generator] { return static_cast<double>(generator() >> 11) * 0x1.0p-53; };
  // R2 sequence (Roberts): steps of the plastic number fill the unit square evenly.
  constexpr double kStep1 = 0.7548776662466927, kStep2 = 0.5698402909980532;
  double u = uniform(), v = uniform();
  const double offset = uniform();
  SurfaceSamples samples{Eigen::MatrixXd(num_points, 3), Eigen::MatrixXd(num_points, 3)};
  Eigen::Index face = 0;
  double reached = areas[0];
  for (int64_t i = 0; i < num_points; ++i) {
    const double target =
        (static_cast<double>(i) + offset) / static_cast<double>(num_points) * total;
    while (reached < target && face + 1 < faces.rows()) reached += areas[++face];
    u = std::fmod(u + kStep1, 1.0);
    v = std::fmod(v + kStep2, 1.0);
    const bool fold = u + v > 1.0;  // The unit square folded onto the triangle.
    const double a = fold ? 1.0 - u : u;
    const double b = fold ? 1.0 - v : v;
    const double weights[3] = {1.0 - a - b, a, b};
    samples.points.row(i).setZero();
    Eigen::RowVector3d normal = Eigen::RowVector3d::Zero();
    for (int c = 0; c < 3; ++c) {
      samples.points.row(i) += weights[c] * vertices.row(faces(face, c));
      normal += weights[c] * normals.row(faces(face, c));
    }
    const double norm = normal.norm();
    samples.normals.row(i) = norm > 1e-9 ? Eigen::RowVector3d(normal / norm)
                                         : Eigen::RowVector3d(normals.row(faces(face, 0)));
  }
  return samples;
}

}  // namespace freetalk::geometry
