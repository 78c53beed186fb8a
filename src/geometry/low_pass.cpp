#include "freetalk/geometry/low_pass.h"

#include <ATen/ATen.h>
#include <torch/csrc/autograd/custom_function.h>
#include <torch/custom_class.h>

#include <algorithm>

#include "freetalk/core/error.h"
#include "freetalk/geometry/sparse_cholesky.h"
#include "freetalk/geometry/surface.h"
#include "freetalk/mesh/weld.h"

namespace freetalk::geometry {
namespace {

using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

constexpr double kLeastMass = 0.05;  // of the mean: slivers have next to none

}  // namespace

struct FactoredLowPass : torch::CustomClassHolder {
  Eigen::VectorXi vertex_of;  // (V,) of the welded surface
  Eigen::VectorXd shares;     // (W,) mass, for each of the vertices that became one
  std::unique_ptr<const SparseCholesky> factor;

  /// What a frame's field (V, C) becomes, or (backward) a gradient of what it became.
  void run(const double* in, double* out, Eigen::Index channels, bool backward) const {
    const Eigen::Map<const Rows> given(in, vertex_of.size(), channels);
    Rows field = Rows::Zero(shares.size(), channels);
    for (Eigen::Index v = 0; v < given.rows(); ++v) field.row(vertex_of[v]) += given.row(v);
    if (!backward) field = shares.asDiagonal() * field;
    factor->solve(field.data(), channels);
    if (backward) field = shares.asDiagonal() * field;
    Eigen::Map<Rows>(out, given.rows(), channels) = field(vertex_of, Eigen::all);
  }

  at::Tensor run(const at::Tensor& fields, bool backward) const {
    const at::Tensor given = fields.to(at::kCPU, at::kDouble).contiguous();
    at::Tensor result = at::empty_like(given);
    const int64_t size = given.size(1) * given.size(2);
    for (int64_t t = 0; t < given.size(0); ++t) {
      run(given.const_data_ptr<double>() + t * size, result.mutable_data_ptr<double>() + t * size,
          given.size(2), backward);
    }
    return result.to(fields.device(), fields.scalar_type());
  }
};

namespace {

/// The factor is symmetric: a gradient takes the same way as a field, in the other direction.
class LowPass : public torch::autograd::Function<LowPass> {
 public:
  static at::Tensor forward(AutogradContext* context, const at::Tensor& fields,
                            const c10::intrusive_ptr<FactoredLowPass>& factored) {
    context->saved_data["factored"] = c10::IValue::make_capsule(factored);
    return factored->run(fields, /*backward=*/false);
  }
  static variable_list backward(AutogradContext* context, const variable_list& gradients) {
    const auto factored = c10::static_intrusive_pointer_cast<FactoredLowPass>(
        context->saved_data["factored"].toCapsule());
    return {factored->run(gradients.front(), /*backward=*/true), at::Tensor()};
  }
};

}  // namespace

SurfaceLowPass::~SurfaceLowPass() = default;
SurfaceLowPass::SurfaceLowPass(const SurfaceLowPass&) = default;
SurfaceLowPass& SurfaceLowPass::operator=(const SurfaceLowPass&) = default;

SurfaceLowPass::SurfaceLowPass(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                               const Eigen::VectorXd& lengths) {
  FREETALK_CHECK(lengths.size() == vertices.rows(), "low-pass: expected ", vertices.rows(),
                 " lengths, found ", lengths.size());
  FREETALK_CHECK(lengths.allFinite() && (lengths.array() >= 0).all(),
                 "low-pass: lengths must be finite and not negative");
  const mesh::WeldedSurface surface = mesh::weld(vertices, faces, "fragments");
  const Eigen::Index welded = surface.vertices.rows();
  Eigen::VectorXd counts = Eigen::VectorXd::Zero(welded), length = counts;
  for (Eigen::Index v = 0; v < vertices.rows(); ++v) {
    counts[surface.vertex_of[v]] += 1;
    length[surface.vertex_of[v]] += lengths[v];
  }
  length = length.cwiseQuotient(counts);
  Eigen::VectorXd mass = lumped_mass(surface.vertices, surface.faces);
  mass = mass.cwiseMax(kLeastMass * mass.mean());
  const SparseMatrix laplacian = cotan_laplacian(surface.vertices, surface.faces);
  const Eigen::VectorXd stiffness = length.array().pow(4) / mass.array();
  SparseMatrix system = laplacian * stiffness.asDiagonal() * laplacian;
  for (Eigen::Index v = 0; v < welded; ++v) system.coeffRef(v, v) += mass[v];

  auto made = c10::make_intrusive<FactoredLowPass>();
  made->vertex_of = surface.vertex_of;
  made->shares = mass.cwiseQuotient(counts);
  made->factor = std::make_unique<const SparseCholesky>(system);
  factored_ = std::move(made);
}

at::Tensor SurfaceLowPass::apply(const at::Tensor& fields) const {
  FREETALK_CHECK(fields.dim() == 3 && fields.size(1) == factored_->vertex_of.size(),
                 "low-pass: expected fields (T, ", factored_->vertex_of.size(), ", C), found ",
                 fields.sizes());
  return LowPass::apply(fields, factored_);
}

}  // namespace freetalk::geometry
