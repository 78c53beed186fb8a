// A neural parametric head F = {I, E} [NPHM; FaceTalk Eq. 1]: codes of an identity and an
// expression to a signed distance field.
//
//   F(x, z_id, z_exp) = I(x + E(x, z_id, z_exp), z_id)
//
// Points and distances are in head units: metres times units_per_metre, in FLAME's axes. The
// canonical face, z_exp = 0, has its mouth open.
#pragma once

#include <torch/nn/modules/container/sequential.h>
#include <torch/nn/modules/linear.h>
#include <torch/nn/pimpl.h>

#include <string>

#include "freetalk/head/options.h"

namespace freetalk::head {

/// Points moved to canonical space.
struct CanonicalPoints {
  at::Tensor points;  // (B, N, 3) head units
  at::Tensor hyper;   // (B, N, hyper_dim) where the identity field sees it, else undefined
};

class ParametricHeadImpl : public torch::nn::Module {
 public:
  explicit ParametricHeadImpl(const HeadOptions& options);

  /// Signed distances at posed points.
  /// @param points (B, N, 3). @param z_id (B, identity_dim). @param z_exp (B, expression_dim).
  /// @returns (B, N), negative inside.
  at::Tensor forward(const at::Tensor& points, const at::Tensor& z_id, const at::Tensor& z_exp);
  /// Signed distances at canonical points. @param z_exp undefined: zeros, where I sees it.
  at::Tensor canonical_sdf(const at::Tensor& points, const at::Tensor& z_id,
                           const at::Tensor& z_exp = {}, const at::Tensor& hyper = {});
  /// Posed to canonical points: the backward network, or the forward one inverted by Broyden's
  /// method (15 steps) with gradients of the implicit function.
  CanonicalPoints to_canonical(const at::Tensor& points, const at::Tensor& z_id,
                               const at::Tensor& z_exp);
  /// Canonical to posed points, likewise. @returns (B, N, 3).
  at::Tensor to_posed(const at::Tensor& points, const at::Tensor& z_id, const at::Tensor& z_exp);
  /// @returns (B, num_anchors, 3), canonical.
  at::Tensor anchors(const at::Tensor& z_id);

  /// z_id of a face model's coefficients. @param coefficients (B, num_coefficients).
  at::Tensor identity_code(const at::Tensor& coefficients);
  /// z_exp of expression weights; those of canonical_weights are 0. @param weights (B,
  /// num_weights).
  at::Tensor expression_code(const at::Tensor& weights);
  /// Mean distance of the local codes of mirrored anchors, which NPHM keeps small: a scalar.
  at::Tensor symmetry_distance(const at::Tensor& z_id) const;
  /// z_id of new identities: coefficients from N(0, 1) up to 2.5 where there is identity_map, else
  /// codes about identity_mean with 0.85 identity_scale [NPHM]. @returns (count, identity_dim).
  at::Tensor sample_identity(int64_t count, at::Generator generator);

  int64_t identity_dim() const { return options_.identity().code_dim(); }
  const HeadOptions& options() const { return options_; }
  const IdentityField& identity_field() const { return identity_; }
  /// @throws std::invalid_argument where there is no network this way.
  const DeformationField& deformation(bool backward) const;
  DeformationCodes deformation_codes(const at::Tensor& z_id, const at::Tensor& z_exp);

  at::Tensor rest_expression;    // (expression_dim,) z_exp of the closed mouth; a buffer, as these:
  at::Tensor canonical_weights;  // (num_weights,) expression weights of the canonical face
  at::Tensor identity_mean, identity_scale;  // (identity_dim,) of the codes in training

 private:
  HeadOptions options_;
  IdentityField identity_{nullptr};
  DeformationField to_canonical_{nullptr}, to_posed_{nullptr};
  torch::nn::Linear identity_map_{nullptr};
  torch::nn::Sequential expression_map_{nullptr};
};
TORCH_MODULE(ParametricHead);

}  // namespace freetalk::head
