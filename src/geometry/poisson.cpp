#include "freetalk/geometry/poisson.h"
#include "freetalk/mesh/components.h"
#include "freetalk/mesh/normals.h"

#include <ATen/ATen.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "freetalk/core/error.h"
#include "tensor_conversion.h"

namespace freetalk::geometry {
namespace {

/// The face's tangent frame (X along its first edge) and the gradients of its three hat functions
/// in it; false where the face has no area to speak of.
bool hat_gradients(const Eigen::Matrix3d& corners, Eigen::Matrix3d& frame,
                   Eigen::Matrix<double, 2, 3>& gradients) {
  const Eigen::Vector3d u = corners.row(1) - corners.row(0), v = corners.row(2) - corners.row(0);
  const Eigen::Vector3d normal = u.cross(v);
  const double double_area = normal.norm();
  const double longest = std::max({u.squaredNorm(), v.squaredNorm(), (v - u).squaredNorm()});
  constexpr double kSliver = 1e-6;  // the guard of cotan_laplacian
  if (!(double_area > kSliver * longest)) return false;
  frame.row(0) = u.normalized();
  frame.row(2) = normal / double_area;
  frame.row(1) = frame.row(2).cross(frame.row(0));
  for (int c = 0; c < 3; ++c) {
    const Eigen::Vector3d opposite = corners.row((c + 2) % 3) - corners.row((c + 1) % 3);
    const Eigen::Vector3d gradient = frame.row(2).transpose().cross(opposite) / double_area;
    gradients.col(c) = frame.topRows<2>() * gradient;
  }
  return true;
}

/// First vertex of each welded one.
Eigen::VectorXi first_of_welded(const Eigen::VectorXi& vertex_of) {
  Eigen::VectorXi first = Eigen::VectorXi::Zero(vertex_of.maxCoeff() + 1);
  for (Eigen::Index v = vertex_of.size() - 1; v >= 0; --v) {
    first[vertex_of[v]] = static_cast<int>(v);
  }
  return first;
}

/// (V, V) replaces the values of vertices welded together by their mean.
SparseMatrix mean_of_welded(const Eigen::VectorXi& vertex_of) {
  SparseMatrix belongs(vertex_of.maxCoeff() + 1, vertex_of.size());
  std::vector<Eigen::Triplet<double>> entries;
  for (Eigen::Index v = 0; v < vertex_of.size(); ++v) entries.emplace_back(vertex_of[v], v, 1.0);
  belongs.setFromTriplets(entries.begin(), entries.end());
  const Eigen::VectorXd counts = belongs * Eigen::VectorXd::Ones(vertex_of.size());
  return belongs.transpose() * counts.cwiseInverse().asDiagonal() * belongs;
}

}  // namespace

at::Tensor PoissonSolver::solve(const at::Tensor& rhs, double regularization) const {
  FREETALK_CHECK(rhs.dim() == 2 && rhs.size(0) == num_vertices() &&
                     rhs.scalar_type() == at::kDouble && rhs.is_cpu(),
                 "Poisson solve: expected right-hand sides (", num_vertices(),
                 ", R) float64 on the CPU, found ", rhs.sizes(), " ", rhs.scalar_type());
  FREETALK_CHECK(regularization > 0, "Poisson solve: regularization must be positive, found ",
                 regularization);
  std::shared_ptr<const SparseCholesky> factor;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    auto& known = factors_[regularization];
    if (!known) {
      SparseMatrix shift(num_vertices(), num_vertices());
      shift.setIdentity();
      known = std::make_shared<const SparseCholesky>(laplacian_ + regularization * shift);
    }
    factor = known;
  }
  at::Tensor solution = rhs.clone(at::MemoryFormat::Contiguous);
  factor->solve(solution.data_ptr<double>(), solution.size(1));
  return solution;
}

FaceOperators FaceOperators::scaled(double factor) const {
  FaceOperators result = *this;  // the Laplacian does not depend on the scale
  result.areas = areas * (factor * factor);
  result.gradients = gradients.scaled(1.0 / factor);
  return result;
}

FaceOperators FaceOperators::turned(const at::Tensor& rotation) const {
  FaceOperators result = *this;  // all else is intrinsic
  result.frames = frames.matmul(rotation.to(frames.options()).t());
  return result;
}

FaceOperators FaceOperators::to(at::ScalarType dtype, const c10::Device& device) const {
  FaceOperators result = *this;
  result.faces = faces.to(device);
  result.areas = areas.to(device, dtype);
  result.gradients = gradients.to(dtype, device);
  result.frames = frames.to(device, dtype);
  result.components = components.to(device);
  return result;
}

FaceOperators face_operators(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                             const Eigen::VectorXi& vertex_of) {
  const Eigen::Index count = faces.rows(), num_vertices = vertices.rows();
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(static_cast<size_t>(count) * 6);
  Eigen::MatrixXd frames = Eigen::MatrixXd::Zero(count, 9);
  for (Eigen::Index f = 0; f < count; ++f) {
    Eigen::Matrix3d corners, frame;
    for (int c = 0; c < 3; ++c) corners.row(c) = vertices.row(faces(f, c));
    Eigen::Matrix<double, 2, 3> gradients;
    if (!hat_gradients(corners, frame, gradients)) continue;
    frames.row(f) << frame.row(0), frame.row(1), frame.row(2);
    for (int c = 0; c < 3; ++c) {
      entries.emplace_back(f, faces(f, c), gradients(0, c));
      entries.emplace_back(count + f, faces(f, c), gradients(1, c));
    }
  }
  RowSparseMatrix gradient(2 * count, num_vertices);
  gradient.setFromTriplets(entries.begin(), entries.end());
  Eigen::MatrixXi joined = faces;
  if (vertex_of.size() > 0) {
    gradient = RowSparseMatrix(gradient * mean_of_welded(vertex_of));
    const Eigen::VectorXi first = first_of_welded(vertex_of);
    joined = joined.unaryExpr([&](int v) { return first[vertex_of[v]]; });
  }
  Eigen::VectorXi components = mesh::connected_components(num_vertices, joined);
  if (vertex_of.size() > 0) {
    const Eigen::VectorXi first = first_of_welded(vertex_of);
    components = Eigen::VectorXi(components(Eigen::VectorXi(first(vertex_of))));
  }
  const Eigen::VectorXd areas = mesh::face_areas(vertices, faces);
  const RowSparseMatrix transposed = gradient.transpose();
  const Eigen::VectorXd weights = areas.replicate(2, 1);
  FaceOperators result;
  result.gradients = to_sparse_operator(gradient);
  result.areas = to_tensor(areas).squeeze(1);
  result.frames = to_tensor(frames).view({count, 3, 3});
  result.faces = to_tensor(faces.cast<double>()).to(at::kLong);
  result.components = to_tensor(components.cast<double>()).squeeze(1).to(at::kLong);
  result.num_components = components.maxCoeff() + 1;
  result.solvers = {std::make_shared<const PoissonSolver>(
      SparseMatrix(transposed * weights.asDiagonal() * gradient))};
  return result;
}

FaceOperators concatenate(const std::vector<const FaceOperators*>& parts) {
  std::vector<at::Tensor> faces, areas, frames, components;
  std::vector<SparseOperator> gradients;
  FaceOperators result;
  int64_t first_vertex = 0;
  for (const FaceOperators* part : parts) {
    faces.push_back(part->faces + first_vertex);
    components.push_back(part->components + result.num_components);
    areas.push_back(part->areas);
    gradients.push_back(part->gradients);
    frames.push_back(part->frames);
    first_vertex += part->components.size(0);
    result.num_components += part->num_components;
    result.solvers.insert(result.solvers.end(), part->solvers.begin(), part->solvers.end());
  }
  result.faces = at::cat(faces);
  result.areas = at::cat(areas);
  result.frames = at::cat(frames);
  result.components = at::cat(components);
  result.gradients = concatenate_gradients(gradients);
  return result;
}

at::Tensor unique_edges(const at::Tensor& faces) {
  const at::Tensor corners = faces.to(at::kCPU, at::kLong);
  const at::Tensor next = corners.roll(-1, 1);
  const at::Tensor low = at::minimum(corners, next).flatten(),
                   high = at::maximum(corners, next).flatten();
  const int64_t bound = corners.numel() > 0 ? corners.max().item<int64_t>() + 1 : 1;
  const at::Tensor real = low != high;
  const at::Tensor keys =
      std::get<0>(at::_unique((low * bound + high).masked_select(real), /*sorted=*/true));
  return at::stack({keys.floor_divide(bound), keys.remainder(bound)}, 1);
}

}  // namespace freetalk::geometry
