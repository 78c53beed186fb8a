#include "freetalk/head/identity_field.h"

#include <torch/torch.h>

#include <cmath>

#include "core/autocast.h"
#include "freetalk/core/error.h"
#include "head/constants.h"

namespace freetalk::head {
namespace {

/// (K, 1, 3): -1 where an odd member of a pair sees x mirrored.
at::Tensor mirror_signs(const IdentityOptions& options, const at::TensorOptions& of) {
  at::Tensor signs = at::ones({options.num_members(), 3}, at::kFloat);
  for (int64_t pair = 0; pair < options.num_pairs; ++pair) signs[2 * pair + 1][0] = -1;
  return signs.to(of);
}

}  // namespace

void IdentityOptions::check() const {
  FREETALK_CHECK(global_dim > 0 && local_dim >= 0 && num_anchors > 0,
                 "identity field: global_dim and num_anchors must be positive");
  FREETALK_CHECK(num_members() <= kMaxMembers, "identity field: at most ", kMaxMembers - 1,
                 " anchors, found ", num_anchors);
  FREETALK_CHECK(num_pairs >= 0 && 2 * num_pairs <= num_anchors, "identity field: ", num_pairs,
                 " pairs need at least ", 2 * num_pairs, " anchors, found ", num_anchors);
  FREETALK_CHECK(anchor_hidden > 0 && hyper_dim >= 0 && expression_dim >= 0,
                 "identity field: anchor_hidden must be positive, hyper_dim not negative");
  FREETALK_CHECK(kernel_width > 0 && normalizer_eps > 0,
                 "identity field: kernel_width and normalizer_eps must be positive");
  FREETALK_CHECK(min_weight >= 0 && min_weight < 1, "min_weight must be in [0, 1), found ",
                 min_weight);
  FREETALK_CHECK(background == "learned" || background == "outside",
                 "background must be learned or outside, found ", background);
  local_mlp().check();
}

nn::FieldMlpOptions IdentityOptions::local_mlp() const {
  nn::FieldMlpOptions mlp;
  mlp.point_dim = 3 + hyper_dim;
  mlp.code_dim = global_dim + local_dim + expression_dim;
  mlp.hidden = hidden;
  mlp.num_layers = num_layers;
  return mlp;
}

IdentityFieldImpl::IdentityFieldImpl(const IdentityOptions& options) : options_(options) {
  options.check();
  ensembled_deep_sdf_ = register_module(
      "ensembled_deep_sdf",
      nn::EnsembledFieldMlp(options.num_members(), options.num_pairs, options.local_mlp()));
  const int64_t width = options.anchor_hidden;
  mlp_pos_ = register_module(
      "mlp_pos",
      torch::nn::Sequential(torch::nn::Linear(options.global_dim, width), torch::nn::ReLU(),
                            torch::nn::Linear(width, width), torch::nn::ReLU(),
                            torch::nn::Linear(width, 3 * options.num_anchors)));
  anchors = register_buffer("anchors", torch::zeros({options.num_anchors, 3}));
}

void IdentityFieldImpl::check_query(const FieldQuery& query) const {
  FREETALK_CHECK(query.points.dim() == 3 && query.points.size(2) == 3,
                 "identity field: expected points (B, N, 3), found ", query.points.sizes());
  const int64_t batch = query.points.size(0), count = query.points.size(1);
  const auto expect = [](const char* name, const at::Tensor& tensor, at::IntArrayRef sizes) {
    FREETALK_CHECK(tensor.defined() && tensor.sizes() == sizes, "identity field: expected ", name,
                   " ", sizes, ", found ", tensor.defined() ? tensor.sizes() : at::IntArrayRef());
  };
  expect("identity", query.identity, {batch, options_.code_dim()});
  if (query.hyper.defined()) expect("hyper", query.hyper, {batch, count, options_.hyper_dim});
  if (options_.expression_dim > 0) {
    expect("expression", query.expression, {batch, options_.expression_dim});
  }
}

at::Tensor IdentityFieldImpl::predict_anchors(const at::Tensor& identity) {
  FREETALK_CHECK(identity.dim() == 2 && identity.size(1) == options_.code_dim(),
                 "identity field: expected identity (B, ", options_.code_dim(), "), found ",
                 identity.sizes());
  const core::NoAutocastScope no_autocast;
  const at::Tensor offsets = mlp_pos_->forward(identity.narrow(1, 0, options_.global_dim));
  return offsets.view({-1, options_.num_anchors, 3}) + anchors;
}

at::Tensor IdentityFieldImpl::local_codes(const at::Tensor& identity) const {
  return identity.narrow(1, options_.global_dim, options_.num_members() * options_.local_dim)
      .unflatten(1, {options_.num_members(), options_.local_dim});
}

at::Tensor IdentityFieldImpl::member_codes(const at::Tensor& identity,
                                           const at::Tensor& expression) const {
  const int64_t members = options_.num_members();
  const auto everywhere = [&](const at::Tensor& code) {
    return code.unsqueeze(0).expand({members, code.size(0), code.size(1)});
  };
  std::vector<at::Tensor> parts = {everywhere(identity.narrow(1, 0, options_.global_dim)),
                                   local_codes(identity).transpose(0, 1)};
  if (options_.expression_dim > 0) parts.push_back(everywhere(expression));
  return at::cat(parts, 2);
}

at::Tensor IdentityFieldImpl::weights(const at::Tensor& points, const at::Tensor& placed) const {
  const at::Tensor distance =  // (K - 1, B, N)
      (points.unsqueeze(0) - placed.transpose(0, 1).unsqueeze(2)).norm(2, 3);
  const double variance = options_.kernel_width * options_.kernel_width;
  const at::Tensor near = ((distance + kDistanceOffset).square() / -variance).exp();
  const at::Tensor background =
      at::full({1, points.size(0), points.size(1)}, std::exp(kBackgroundExponent), near.options());
  return at::cat({near, background}, 0);
}

at::Tensor IdentityFieldImpl::forward(const FieldQuery& query) {
  check_query(query);
  const int64_t batch = query.points.size(0), count = query.points.size(1);
  const int64_t members = options_.num_members();
  const at::Tensor placed = predict_anchors(query.identity);
  const at::Tensor raw = weights(query.points, placed);
  const at::Tensor total = raw.sum(0);                                    // (B, N)
  const at::Tensor normalized = raw / (total + options_.normalizer_eps);  // (K, B, N)

  // Rows are sorted by member, then by identity, as the ensemble takes them.
  const at::Tensor chosen = options_.min_weight > 0 ? normalized.detach().gt(options_.min_weight)
                                                    : at::ones_like(normalized, at::kBool);
  const at::Tensor row = chosen.flatten().nonzero().squeeze(1);  // (R,) in (K, B, N)
  const at::Tensor counts = chosen.sum(2).flatten().cpu();       // (K B,)
  nn::EnsembleRows rows;
  rows.first.assign(1, 0);
  for (int64_t segment = 0; segment < members * batch; ++segment) {
    rows.first.push_back(rows.first.back() + counts.const_data_ptr<int64_t>()[segment]);
  }
  const at::Tensor point_of_row = row.remainder(batch * count);
  const at::Tensor segment_of_row = row.floor_divide(count);
  const at::Tensor member_of_row = row.floor_divide(batch * count);

  const at::Tensor origins =  // (K B, 3); the background's is 0
      at::cat({placed.transpose(0, 1), at::zeros_like(placed.select(1, 0).unsqueeze(0))}, 0)
          .reshape({-1, 3});
  const at::Tensor local = (at::embedding(query.points.reshape({-1, 3}), point_of_row) -
                            at::embedding(origins, segment_of_row)) *
                           mirror_signs(options_, placed.options()).index_select(0, member_of_row);
  rows.points = local;
  if (options_.hyper_dim > 0) {
    const at::Tensor hyper =
        query.hyper.defined()
            ? at::embedding(query.hyper.reshape({-1, options_.hyper_dim}), point_of_row)
            : at::zeros({row.size(0), options_.hyper_dim}, local.options());
    rows.points = at::cat({local, hyper}, 1);
  }
  at::Tensor values =  // (R,)
      ensembled_deep_sdf_->forward(rows, member_codes(query.identity, query.expression)).squeeze(1);
  if (!is_training() && options_.background == "outside") {
    values = at::where(member_of_row.eq(members - 1), at::ones_like(values), values);
  }

  const at::Tensor kept = normalized.flatten().index_select(0, row);
  const at::Tensor nothing = at::zeros({batch * count}, values.options());
  const at::Tensor blended = nothing.index_add(0, point_of_row, kept * values);
  if (options_.min_weight == 0) return blended.view({batch, count});
  // What is left out goes to those kept; where none is, the field has faded to 0.
  const at::Tensor kept_total = nothing.index_add(0, point_of_row, kept);
  const at::Tensor all = (total / (total + options_.normalizer_eps)).flatten();
  const at::Tensor share = all / kept_total.clamp_min(options_.min_weight);
  return (blended * share).view({batch, count});
}

}  // namespace freetalk::head
