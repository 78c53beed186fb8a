#include "morph_normals.h"

#include <ATen/ATen.h>
#include <Eigen/Geometry>

#include <algorithm>

#include "freetalk/mesh/normals.h"
#include "freetalk/mesh/weld.h"

namespace freetalk::animation {
namespace {

using Rows = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

}  // namespace

MorphNormals::MorphNormals(const mesh::Mesh& mesh) {
  mesh::WeldedSurface welded = mesh::weld(mesh.vertices, mesh.faces, "coincident");
  vertices_ = std::move(welded.vertices);
  faces_ = std::move(welded.faces);
  vertex_of_ = std::move(welded.vertex_of);
  first_.assign(vertices_.rows(), 0);
  for (Eigen::Index v = vertex_of_.size(); v-- > 0;) first_[vertex_of_[v]] = static_cast<int>(v);
  const Eigen::MatrixXd of_faces = mesh::face_normals(vertices_, faces_);
  normals_ = mesh::mean_normals(of_faces, faces_, vertices_.rows());
  Eigen::MatrixXd sums = Eigen::MatrixXd::Zero(vertices_.rows(), 3);
  for (Eigen::Index f = 0; f < faces_.rows(); ++f) {
    for (int c = 0; c < 3; ++c) sums.row(faces_(f, c)) += of_faces.row(f);
  }
  lengths_ = sums.rowwise().norm();
  rest_ = at::empty({vertex_of_.size(), 3}, at::kFloat);
  Eigen::Map<Rows> rest(rest_.data_ptr<float>(), vertex_of_.size(), 3);
  for (Eigen::Index v = 0; v < vertex_of_.size(); ++v) {
    rest.row(v) = normals_.row(vertex_of_[v]).cast<float>();
  }
}

at::Tensor MorphNormals::derivative(const at::Tensor& target) const {
  const auto contiguous = target.contiguous();
  const Eigen::Map<const Rows> moved(contiguous.data_ptr<float>(), contiguous.size(0), 3);
  Eigen::MatrixXd sums = Eigen::MatrixXd::Zero(vertices_.rows(), 3);
  for (Eigen::Index f = 0; f < faces_.rows(); ++f) {
    Eigen::Vector3d corner[3], change[3];
    for (int c = 0; c < 3; ++c) {
      corner[c] = vertices_.row(faces_(f, c));
      change[c] = moved.row(first_[faces_(f, c)]).cast<double>();
    }
    const Eigen::Vector3d a = corner[1] - corner[0], b = corner[2] - corner[0];
    const Eigen::Vector3d area = a.cross(b);
    const double size = area.norm();
    if (!(size > 0.0)) continue;
    const Eigen::Vector3d da = change[1] - change[0], db = change[2] - change[0];
    const Eigen::Vector3d turned = (da.cross(b) + a.cross(db)) / size, normal = area / size;
    const Eigen::RowVector3d d = (turned - normal * normal.dot(turned)).transpose();
    for (int c = 0; c < 3; ++c) sums.row(faces_(f, c)) += d;
  }
  constexpr double kCancelled = 1e-3;  // opposite faces have no direction that could turn
  for (Eigen::Index v = 0; v < sums.rows(); ++v) {
    const Eigen::RowVector3d n = normals_.row(v), d = sums.row(v);
    const double length = lengths_[v];
    sums.row(v) = length > kCancelled ? ((d - n * n.dot(d)) / length).eval() : (0.0 * d).eval();
  }
  // Slivers turn with any noise; beyond this a normal has turned for good.
  constexpr double kLargest = 4.0;
  const auto result = at::empty({vertex_of_.size(), 3}, at::kFloat);
  Eigen::Map<Rows> rows(result.data_ptr<float>(), vertex_of_.size(), 3);
  for (Eigen::Index v = 0; v < vertex_of_.size(); ++v) {
    const Eigen::RowVector3d d = sums.row(vertex_of_[v]);
    rows.row(v) = (d * std::min(1.0, kLargest / std::max(d.norm(), 1e-30))).cast<float>();
  }
  return result;
}

}  // namespace freetalk::animation
