#include "freetalk/geometry/operators.h"

#include <ATen/ATen.h>

#include <cmath>

#include "freetalk/core/error.h"
#include "freetalk/geometry/eigenbasis.h"
#include "freetalk/geometry/surface.h"
#include "tensor_conversion.h"

namespace freetalk::geometry {
namespace {

void check_surface(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                   const OperatorOptions& options, const std::string& name) {
  options.check();
  FREETALK_CHECK(vertices.cols() == 3 && vertices.rows() > 0, "operators of ", name,
                 " need vertices of shape (V, 3), found (", vertices.rows(), ", ", vertices.cols(),
                 ")");
  FREETALK_CHECK(faces.cols() == 3 && faces.rows() > 0, "operators of ", name,
                 " need triangles of shape (F, 3), found (", faces.rows(), ", ", faces.cols(), ")");
  FREETALK_CHECK(vertices.allFinite(), "operators of ", name,
                 " need finite vertices; the mesh has NaN or infinite coordinates");
  FREETALK_CHECK(faces.minCoeff() >= 0 && faces.maxCoeff() < vertices.rows(), "operators of ", name,
                 " need face indices within 0 .. ", vertices.rows() - 1, ", found ",
                 faces.minCoeff(), " .. ", faces.maxCoeff());
  FREETALK_CHECK(options.k_eig <= vertices.rows(), "operators of ", name, " were asked for ",
                 options.k_eig, " eigenpairs but the mesh has ", vertices.rows(),
                 " vertices; use k_eig <= ", vertices.rows());
  const double area = face_areas(vertices, faces).sum();
  FREETALK_CHECK(std::isfinite(area) && area > 0.0, "operators of ", name,
                 " need a surface; all faces of the mesh have zero area");
}

at::Tensor with_values(const at::Tensor& csr, const at::Tensor& values) {
  return make_csr_tensor(csr.crow_indices(), csr.col_indices(), values, csr.sizes());
}

}  // namespace

void OperatorOptions::check() const {
  FREETALK_CHECK(k_eig >= 1, "k_eig must be at least 1, found ", k_eig);
  FREETALK_CHECK(laplacian == "cotan", "laplacian must be \"cotan\", found \"", laplacian, "\"");
  FREETALK_CHECK(regularization == "relative" || regularization == "absolute",
                 "regularization must be \"relative\" or \"absolute\", found \"", regularization,
                 "\"");
  FREETALK_CHECK(residual_tolerance > 0.0, "residual_tolerance must be positive, found ",
                 residual_tolerance);
}

SurfaceOperators SurfaceOperators::scaled(double factor) const {
  FREETALK_CHECK(std::isfinite(factor) && factor > 0.0, "scale must be positive, found ", factor);
  SurfaceOperators result = *this;
  result.mass = mass * (factor * factor);
  result.evals = evals / (factor * factor);
  result.evecs = evecs / factor;
  result.gradients = with_values(gradients, gradients.values() / factor);
  result.gradients_transposed =
      with_values(gradients_transposed, gradients_transposed.values() / factor);
  return result;
}

SurfaceOperators SurfaceOperators::to(at::ScalarType dtype, const c10::Device& device) const {
  const auto dense = [&](const at::Tensor& t) { return t.to(device, dtype); };
  const auto sparse = [&](const at::Tensor& t) {
    return make_csr_tensor(t.crow_indices().to(device), t.col_indices().to(device),
                           t.values().to(device, dtype), t.sizes());
  };
  return {dense(mass),
          dense(evals),
          dense(evecs),
          sparse(gradients),
          sparse(gradients_transposed),
          dense(normals),
          dense(frames),
          dense(residuals)};
}

SurfaceOperators surface_operators(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                   const OperatorOptions& options, const std::string& name) {
  check_surface(vertices, faces, options, name);
  const auto regularization =
      options.regularization == "absolute" ? Regularization::kAbsolute : Regularization::kRelative;
  const Eigen::VectorXd mass = lumped_mass(vertices, faces);
  const Eigenbasis basis = eigenbasis(cotan_laplacian(vertices, faces, regularization), mass,
                                      options.k_eig, options.residual_tolerance, name);
  const Eigen::MatrixXd normals = vertex_normals(vertices, faces);
  const Eigen::MatrixXd frames = tangent_frames(normals);
  const RowSparseMatrix gradient = vertex_gradient(vertices, faces, frames, regularization);
  SurfaceOperators operators;
  operators.mass = to_tensor(mass).squeeze(1);
  operators.evals = to_tensor(basis.evals).squeeze(1);
  operators.evecs = to_tensor(basis.evecs);
  operators.residuals = to_tensor(basis.residuals).squeeze(1);
  operators.normals = to_tensor(normals);
  operators.frames = to_tensor(frames).view({vertices.rows(), 3, 3});
  operators.gradients = to_csr_tensor(gradient);
  operators.gradients_transposed = to_csr_tensor(gradient.transpose());
  return operators;
}

}  // namespace freetalk::geometry
