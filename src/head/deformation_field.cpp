#include "freetalk/head/deformation_field.h"

#include <torch/torch.h>

#include "core/autocast.h"
#include "freetalk/core/error.h"

namespace freetalk::head {

void DeformationOptions::check() const {
  FREETALK_CHECK(identity_dim > 0 && identity_code_dim > 0 && expression_dim > 0 && hyper_dim >= 0,
                 "deformation field: dimensions must be positive, hyper_dim not negative");
  FREETALK_CHECK(identity_noise >= 0, "identity_noise must not be negative, found ",
                 identity_noise);
  mlp().check();
}

nn::FieldMlpOptions DeformationOptions::mlp() const {
  nn::FieldMlpOptions mlp;
  mlp.code_dim = identity_code_dim + expression_dim;
  mlp.hidden = hidden;
  mlp.num_layers = num_layers;
  mlp.out_dim = 3 + hyper_dim;
  return mlp;
}

DeformationFieldImpl::DeformationFieldImpl(const DeformationOptions& options) : options_(options) {
  options.check();
  compressor_ = register_module(
      "compressor",
      torch::nn::Sequential(torch::nn::Linear(options.identity_dim, options.identity_code_dim)));
  def_deep_sdf_ = register_module("defDeepSDF", nn::FieldMlp(options.mlp()));
}

at::Tensor DeformationFieldImpl::compress(const at::Tensor& identity, const at::Tensor& anchors) {
  const at::Tensor both = at::cat({identity, anchors.flatten(1)}, 1);
  FREETALK_CHECK(both.size(1) == options_.identity_dim,
                 "deformation field: expected identity and anchors of ", options_.identity_dim,
                 " channels together, found ", both.size(1));
  const core::NoAutocastScope no_autocast;
  return compressor_->forward(both);
}

at::Tensor DeformationFieldImpl::code(const DeformationCodes& codes) {
  at::Tensor compressed = compress(codes.identity, codes.anchors);
  FREETALK_CHECK(codes.expression.dim() == 2 && codes.expression.size(0) == compressed.size(0) &&
                     codes.expression.size(1) == options_.expression_dim,
                 "deformation field: expected expression (", compressed.size(0), ", ",
                 options_.expression_dim, "), found ", codes.expression.sizes());
  if (is_training() && options_.identity_noise > 0) {
    compressed = compressed + options_.identity_noise * at::randn_like(compressed);
  }
  return at::cat({compressed, codes.expression}, 1);
}

at::Tensor DeformationFieldImpl::forward(const at::Tensor& points, const DeformationCodes& codes) {
  return def_deep_sdf_->forward(points, code(codes));
}

}  // namespace freetalk::head
