#include "freetalk/head/parametric_head.h"

#include <torch/torch.h>

#include "core/autocast.h"
#include "freetalk/core/error.h"
#include "freetalk/core/torch_error.h"
#include "head/invert.h"

namespace freetalk::head {
namespace {

constexpr double kLargestCoefficient = 2.5;  // of sampled identities
constexpr double kSampleScale = 0.85;        // of sampled codes [NPHM's code]

/// The points that a deformation moves to the given ones.
at::Tensor inverted(DeformationFieldImpl& field, const at::Tensor& points,
                    const DeformationCodes& codes) {
  const at::Tensor code = field.code(codes);
  nn::FieldMlp network = field.network();
  return invert(
      {[&](const at::Tensor& x) { return network->forward(x, code).narrow(2, 0, 3); },
       [&](const at::Tensor& x) { return network->with_jacobian(x, code).second.narrow(2, 0, 3); }},
      points);
}

}  // namespace

ParametricHeadImpl::ParametricHeadImpl(const HeadOptions& options) : options_(options) {
  options.check();
  identity_ = register_module("identity", IdentityField(options.identity()));
  if (options.has_backward()) {
    to_canonical_ =
        register_module("deformation_backward", DeformationField(options.deformation(true)));
  }
  if (options.has_forward()) {
    to_posed_ =
        register_module("deformation_forward", DeformationField(options.deformation(false)));
  }
  if (options.num_coefficients > 0) {
    identity_map_ = register_module(
        "identity_map",
        torch::nn::Linear(
            torch::nn::LinearOptions(options.num_coefficients, identity_dim()).bias(false)));
  }
  if (options.num_weights > 0) {
    const int64_t hidden = options.expression_map_hidden;
    expression_map_ = register_module(
        "expression_map",
        torch::nn::Sequential(torch::nn::Linear(options.num_weights, hidden), torch::nn::SiLU(),
                              torch::nn::Linear(hidden, options.expression_dim)));
  }
  rest_expression = register_buffer("rest_expression", torch::zeros({options.expression_dim}));
  canonical_weights = register_buffer("canonical_weights", torch::zeros({options.num_weights}));
  identity_mean = register_buffer("identity_mean", torch::zeros({identity_dim()}));
  identity_scale = register_buffer("identity_scale", torch::ones({identity_dim()}));
}

const DeformationField& ParametricHeadImpl::deformation(bool backward) const {
  const DeformationField& field = backward ? to_canonical_ : to_posed_;
  FREETALK_CHECK(!field.is_empty(), "this head has no ", backward ? "backward" : "forward",
                 " network: its direction is ", options_.direction);
  return field;
}

DeformationCodes ParametricHeadImpl::deformation_codes(const at::Tensor& z_id,
                                                       const at::Tensor& z_exp) {
  return {z_id, anchors(z_id), z_exp};
}

at::Tensor ParametricHeadImpl::forward(const at::Tensor& points, const at::Tensor& z_id,
                                       const at::Tensor& z_exp) {
  return core::with_plain_errors("ParametricHead", [&] {
    const CanonicalPoints canonical = to_canonical(points, z_id, z_exp);
    return canonical_sdf(canonical.points, z_id, z_exp, canonical.hyper);
  });
}

at::Tensor ParametricHeadImpl::canonical_sdf(const at::Tensor& points, const at::Tensor& z_id,
                                             const at::Tensor& z_exp, const at::Tensor& hyper) {
  at::Tensor expression;
  if (options_.identity_sees == "expression") {
    expression = z_exp.defined()
                     ? z_exp
                     : at::zeros({z_id.size(0), options_.expression_dim}, z_id.options());
  }
  return core::with_plain_errors("ParametricHead", [&] {
    return identity_->forward({points, z_id, hyper, expression});
  });
}

CanonicalPoints ParametricHeadImpl::to_canonical(const at::Tensor& points, const at::Tensor& z_id,
                                                 const at::Tensor& z_exp) {
  const DeformationCodes codes = deformation_codes(z_id, z_exp);
  if (!options_.has_backward()) return {inverted(*to_posed_, points, codes), {}};
  const at::Tensor moved = to_canonical_->forward(points, codes);
  CanonicalPoints result{points + moved.narrow(2, 0, 3), {}};
  if (options_.identity_sees == "hyper") result.hyper = moved.narrow(2, 3, options_.hyper_dim);
  return result;
}

at::Tensor ParametricHeadImpl::to_posed(const at::Tensor& points, const at::Tensor& z_id,
                                        const at::Tensor& z_exp) {
  const DeformationCodes codes = deformation_codes(z_id, z_exp);
  if (!options_.has_forward()) return inverted(*to_canonical_, points, codes);
  return points + to_posed_->forward(points, codes);
}

at::Tensor ParametricHeadImpl::anchors(const at::Tensor& z_id) {
  return identity_->predict_anchors(z_id);
}

at::Tensor ParametricHeadImpl::identity_code(const at::Tensor& coefficients) {
  FREETALK_CHECK(!identity_map_.is_empty(),
                 "this head has no map of coefficients: num_coefficients is 0");
  FREETALK_CHECK(coefficients.dim() == 2 && coefficients.size(1) == options_.num_coefficients,
                 "identity_code: expected coefficients (B, ", options_.num_coefficients,
                 "), found ", coefficients.sizes());
  const core::NoAutocastScope no_autocast;
  return identity_map_->forward(coefficients);
}

at::Tensor ParametricHeadImpl::expression_code(const at::Tensor& weights) {
  FREETALK_CHECK(!expression_map_.is_empty(),
                 "this head has no map of expression weights: num_weights is 0");
  FREETALK_CHECK(weights.dim() == 2 && weights.size(1) == options_.num_weights,
                 "expression_code: expected weights (B, ", options_.num_weights, "), found ",
                 weights.sizes());
  const core::NoAutocastScope no_autocast;
  return expression_map_->forward(weights) -
         expression_map_->forward(canonical_weights.unsqueeze(0));
}

at::Tensor ParametricHeadImpl::symmetry_distance(const at::Tensor& z_id) const {
  const at::Tensor local = identity_->local_codes(z_id).narrow(1, 0, 2 * options_.num_pairs);
  const at::Tensor pairs = local.unflatten(1, {options_.num_pairs, 2});
  return (pairs.select(2, 0) - pairs.select(2, 1)).norm(2, 2).mean();
}

at::Tensor ParametricHeadImpl::sample_identity(int64_t count, at::Generator generator) {
  const bool mapped = !identity_map_.is_empty();
  const int64_t channels = mapped ? options_.num_coefficients : identity_dim();
  const at::Tensor noise = at::randn({count, channels}, generator, identity_mean.options());
  if (mapped) return identity_code(noise.clamp(-kLargestCoefficient, kLargestCoefficient));
  return identity_mean + kSampleScale * identity_scale * noise;
}

}  // namespace freetalk::head
