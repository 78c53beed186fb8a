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

at::Tensor transposed_like(const at::Tensor& csr) {
  const at::Tensor transposed =
      transpose_csr(make_csr_tensor(csr.crow_indices().to(at::kCPU), csr.col_indices().to(at::kCPU),
                                    csr.values().to(at::kCPU, at::kDouble), csr.sizes()));
  return make_csr_tensor(transposed.crow_indices().to(csr.device()),
                         transposed.col_indices().to(csr.device()),
                         transposed.values().to(csr.values().options()), transposed.sizes());
}

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
  result.gradients = csr_with_values(gradients, gradients.values() / factor);
  result.gradients_transposed =
      csr_with_values(gradients_transposed, gradients_transposed.values() / factor);
  return result;
}

FaceOperators FaceOperators::turned(const at::Tensor& rotation) const {
  FaceOperators result = *this;  // all else is intrinsic
  result.frames = frames.matmul(rotation.to(frames.options()).t());
  return result;
}

FaceOperators FaceOperators::to(at::ScalarType dtype, const c10::Device& device) const {
  const auto sparse = [&](const at::Tensor& t) {
    return make_csr_tensor(t.crow_indices().to(device), t.col_indices().to(device),
                           t.values().to(device, dtype), t.sizes());
  };
  FaceOperators result = *this;
  result.faces = faces.to(device);
  result.areas = areas.to(device, dtype);
  result.gradients = sparse(gradients);
  result.gradients_transposed = sparse(gradients_transposed);
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
  result.gradients = to_csr_tensor(gradient);
  result.gradients_transposed = to_csr_tensor(transposed);
  result.areas = to_tensor(areas).squeeze(1);
  result.frames = to_tensor(frames).view({count, 3, 3});
  result.faces = to_tensor(faces.cast<double>()).to(at::kLong);
  result.components = to_tensor(components.cast<double>()).squeeze(1).to(at::kLong);
  result.solvers = {std::make_shared<const PoissonSolver>(
      SparseMatrix(transposed * weights.asDiagonal() * gradient))};
  return result;
}

FaceOperators concatenate(const std::vector<const FaceOperators*>& parts) {
  std::vector<at::Tensor> faces, areas, gradients, frames, components;
  FaceOperators result;
  int64_t first_vertex = 0, first_component = 0;
  for (const FaceOperators* part : parts) {
    faces.push_back(part->faces + first_vertex);
    components.push_back(part->components + first_component);
    areas.push_back(part->areas);
    gradients.push_back(part->gradients);
    frames.push_back(part->frames);
    first_vertex += part->components.size(0);
    first_component += part->components.max().item<int64_t>() + 1;
    result.solvers.insert(result.solvers.end(), part->solvers.begin(), part->solvers.end());
  }
  result.faces = at::cat(faces);
  result.areas = at::cat(areas);
  result.frames = at::cat(frames);
  result.components = at::cat(components);
  result.gradients = concatenate_gradients(gradients);
  result.gradients_transposed = transposed_like(result.gradients);
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

at::Tensor concatenate_gradients(const std::vector<at::Tensor>& parts) {
  std::vector<at::Tensor> counts, columns, values;
  int64_t rows = 0, cols = 0;
  for (const at::Tensor& part : parts) {
    rows += part.size(0);
    cols += part.size(1);
  }
  for (int64_t half = 0; half < 2; ++half) {
    int64_t first_vertex = 0;
    for (const at::Tensor& part : parts) {
      const int64_t size = part.size(0) / 2;
      const at::Tensor offsets = part.crow_indices();
      const int64_t begin = offsets[half * size].item<int64_t>(),
                    end = offsets[(half + 1) * size].item<int64_t>();
      counts.push_back(offsets.narrow(0, half * size, size + 1).diff());
      columns.push_back(part.col_indices().narrow(0, begin, end - begin) + first_vertex);
      values.push_back(part.values().narrow(0, begin, end - begin));
      first_vertex += part.size(1);
    }
  }
  const at::Tensor total = at::cat(counts).cumsum(0);
  return make_csr_tensor(at::cat({at::zeros({1}, total.options()), total}), at::cat(columns),
                         at::cat(values), {rows, cols});
}

}  // namespace freetalk::geometry
