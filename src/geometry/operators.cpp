#include "freetalk/geometry/operators.h"

#include <ATen/ATen.h>

#include <cmath>
#include <vector>

#include "core/deferred.h"
#include "freetalk/core/error.h"
#include "freetalk/geometry/eigenbasis.h"
#include "freetalk/geometry/surface.h"
#include "freetalk/mesh/normals.h"
#include "freetalk/mesh/weld.h"
#include "laplacian_by_name.h"
#include "operators_faces.h"
#include "point_cloud_operators.h"
#include "tensor_conversion.h"

namespace freetalk::geometry {
namespace {

void check_surface(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                   const OperatorOptions& options, const std::string& name) {
  options.check();
  FREETALK_CHECK(vertices.cols() == 3 && vertices.rows() > 0, "operators of ", name,
                 " need vertices of shape (V, 3), found (", vertices.rows(), ", ", vertices.cols(),
                 ")");
  const bool cloud = faces.rows() == 0 && options.laplacian == "robust";
  FREETALK_CHECK(cloud || (faces.cols() == 3 && faces.rows() > 0), "operators of ", name,
                 " need triangles of shape (F, 3), found (", faces.rows(), ", ", faces.cols(),
                 "); of a point cloud they need laplacian = \"robust\"");
  FREETALK_CHECK(vertices.allFinite(), "operators of ", name,
                 " need finite vertices; the mesh has NaN or infinite coordinates");
  FREETALK_CHECK(options.k_eig <= vertices.rows(), "operators of ", name, " were asked for ",
                 options.k_eig, " eigenpairs but the mesh has ", vertices.rows(),
                 " vertices; use k_eig <= ", vertices.rows());
  if (cloud) return;
  FREETALK_CHECK(faces.minCoeff() >= 0 && faces.maxCoeff() < vertices.rows(), "operators of ", name,
                 " need face indices within 0 .. ", vertices.rows() - 1, ", found ",
                 faces.minCoeff(), " .. ", faces.maxCoeff());
  const double area = mesh::face_areas(vertices, faces).sum();
  FREETALK_CHECK(std::isfinite(area) && area > 0.0, "operators of ", name,
                 " need a surface; all faces of the mesh have zero area");
}

/// Vertex normals. With kAbsolute a face counts by 2 A / (2 A + 1e-6), as in the public package: on
/// meshes of unit size that takes weight from small faces only.
Eigen::MatrixXd normals_of(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                           Regularization regularization) {
  if (regularization == Regularization::kRelative) return mesh::vertex_normals(vertices, faces);
  const Eigen::ArrayXd doubled = 2.0 * mesh::face_areas(vertices, faces).array();
  Eigen::MatrixXd of_faces = mesh::face_normals(vertices, faces);
  of_faces.array().colwise() *= doubled / (doubled + 1e-6);
  return mesh::mean_normals(of_faces, faces, vertices.rows());
}

/// Row w of (W, ...) at every vertex welded into w.
Eigen::MatrixXd at_every_vertex(const Eigen::MatrixXd& rows, const Eigen::VectorXi& vertex_of) {
  return rows(vertex_of, Eigen::all);
}

/// (2V, V) gradient of a welded surface (2W, W): the vertices of one spot share its gradient, which
/// sees the mean of their values.
RowSparseMatrix at_every_vertex(const RowSparseMatrix& gradient, const Eigen::VectorXi& vertex_of,
                                const Eigen::VectorXd& share) {
  const Eigen::Index count = vertex_of.size();
  const Eigen::Index welded = gradient.cols();
  std::vector<Eigen::Triplet<double>> copies;
  std::vector<Eigen::Triplet<double>> means;
  copies.reserve(static_cast<size_t>(2 * count));
  means.reserve(static_cast<size_t>(count));
  for (Eigen::Index v = 0; v < count; ++v) {
    copies.emplace_back(v, vertex_of[v], 1.0);
    copies.emplace_back(count + v, welded + vertex_of[v], 1.0);
    means.emplace_back(vertex_of[v], v, share[v]);
  }
  RowSparseMatrix copy(2 * count, 2 * welded);
  copy.setFromTriplets(copies.begin(), copies.end());
  RowSparseMatrix mean(welded, count);
  mean.setFromTriplets(means.begin(), means.end());
  return copy * gradient * mean;
}

/// (V,) one over the number of vertices welded together with each.
Eigen::VectorXd shares(const Eigen::VectorXi& vertex_of, Eigen::Index welded) {
  Eigen::VectorXd count = Eigen::VectorXd::Zero(welded);
  for (Eigen::Index v = 0; v < vertex_of.size(); ++v) count[vertex_of[v]] += 1.0;
  return count.cwiseInverse()(vertex_of);
}

/// Operators of the original vertices: those of one spot share its row and its mass.
SurfaceOperators expanded(const mesh::WeldedSurface& surface, const Eigen::VectorXd& mass,
                          const Eigenbasis& basis, const Eigen::MatrixXd& normals,
                          const Eigen::MatrixXd& frames, const RowSparseMatrix& welded_gradient) {
  const Eigen::VectorXi& vertex_of = surface.vertex_of;
  const Eigen::VectorXd share = shares(vertex_of, surface.vertices.rows());
  const bool as_it_is = vertex_of.size() == surface.vertices.rows();
  const RowSparseMatrix gradient =
      as_it_is ? welded_gradient : at_every_vertex(welded_gradient, vertex_of, share);
  SurfaceOperators operators;
  operators.mass = to_tensor(Eigen::MatrixXd(mass(vertex_of).cwiseProduct(share))).squeeze(1);
  operators.evals = to_tensor(basis.evals).squeeze(1);
  operators.evecs = to_tensor(at_every_vertex(basis.evecs, vertex_of));
  operators.residuals = to_tensor(basis.residuals).squeeze(1);
  operators.normals = to_tensor(at_every_vertex(normals, vertex_of));
  operators.frames = to_tensor(at_every_vertex(frames, vertex_of)).view({vertex_of.size(), 3, 3});
  operators.gradients = to_sparse_operator(gradient);
  return operators;
}

}  // namespace

void OperatorOptions::check() const {
  FREETALK_CHECK(k_eig >= 1, "k_eig must be at least 1, found ", k_eig);
  FREETALK_CHECK(laplacian == "cotan" || laplacian == "robust",
                 "laplacian must be \"cotan\" or \"robust\", found \"", laplacian, "\"");
  FREETALK_CHECK(regularization == "relative" || regularization == "absolute",
                 "regularization must be \"relative\" or \"absolute\", found \"", regularization,
                 "\"");
  FREETALK_CHECK(residual_tolerance > 0.0, "residual_tolerance must be positive, found ",
                 residual_tolerance);
  mesh::check_weld(weld);
}

SurfaceOperators SurfaceOperators::scaled(double factor) const {
  FREETALK_CHECK(std::isfinite(factor) && factor > 0.0, "scale must be positive, found ", factor);
  SurfaceOperators result = *this;
  result.mass = mass * (factor * factor);
  result.evals = evals / (factor * factor);
  result.evecs = evecs / factor;
  result.gradients = gradients.scaled(1.0 / factor);
  if (on_faces) {
    result.on_faces =
        core::defer([faces = on_faces, factor] { return faces->get().scaled(factor); });
  }
  return result;
}

SurfaceOperators SurfaceOperators::to(at::ScalarType dtype, const c10::Device& device) const {
  const auto dense = [&](const at::Tensor& t) { return t.to(device, dtype); };
  std::shared_ptr<const core::Deferred<FaceOperators>> faces;
  if (on_faces) {
    faces = core::defer([from = on_faces, dtype, device] { return from->get().to(dtype, device); });
  }
  return {dense(mass),    dense(evals),  dense(evecs),     gradients.to(dtype, device),
          dense(normals), dense(frames), dense(residuals), faces,
          offsets};
}

SurfaceOperators surface_operators(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                   const OperatorOptions& options, const std::string& name,
                                   const std::function<void(double)>& progress) {
  check_surface(vertices, faces, options, name);
  if (faces.rows() == 0) return point_cloud_operators(vertices, options, name, progress);
  const mesh::WeldedSurface surface = mesh::weld(vertices, faces, options.weld);
  const Eigen::Index welded = surface.vertices.rows();
  FREETALK_CHECK(options.k_eig <= welded, "operators of ", name, " were asked for ", options.k_eig,
                 " eigenpairs but the mesh has ", welded,
                 " vertices when welded; use k_eig <= ", welded);
  const auto [laplacian, mass] = laplacian_by_name(surface.vertices, surface.faces, options);
  const Eigenbasis basis = eigenbasis(
      laplacian, mass, {options.k_eig, options.residual_tolerance, "auto"}, name, progress);
  const Eigen::MatrixXd normals =
      normals_of(surface.vertices, surface.faces, regularization_of(options));
  const Eigen::MatrixXd frames = tangent_frames(normals);
  const RowSparseMatrix gradient =
      vertex_gradient(surface.vertices, surface.faces, frames, regularization_of(options));
  SurfaceOperators operators = expanded(surface, mass, basis, normals, frames, gradient);
  attach_faces(operators, vertices, faces, options.weld != "none");
  return operators;
}

}  // namespace freetalk::geometry
