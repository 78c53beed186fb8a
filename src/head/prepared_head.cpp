#include "freetalk/head/prepared_head.h"

#include <torch/torch.h>

#include <optional>

#include "core/parallel.h"
#include "freetalk/core/error.h"
#include "head/identity_engine.h"
#include "head/invert.h"
#include "nn/field_inference.h"

namespace freetalk::head {
namespace {

constexpr int64_t kGrain = 384;  // points a thread takes at a time: whole tiles

/// (N, 3) to (N, out_dim) by a packed network, in parallel.
at::Tensor run(const nn::PackedFieldMlp& network, const nn::FoldedCode& code,
               const at::Tensor& points, int64_t out_dim) {
  const int64_t count = points.size(0), dim = points.size(1);
  at::Tensor result = at::empty({count, out_dim}, at::kFloat);
  const auto* from = points.const_data_ptr<float>();
  auto* to = result.mutable_data_ptr<float>();
  core::parallel_for(0, (count + kGrain - 1) / kGrain, 1, [&](int64_t first, int64_t last) {
    const int64_t begin = first * kGrain, end = std::min(count, last * kGrain);
    network.run(from + begin * dim, end - begin, code, to + begin * out_dim);
  });
  return result;
}

at::Tensor plain(const at::Tensor& x) { return x.detach().to(at::kFloat).contiguous(); }

}  // namespace

void PreparedOptions::check() const {
  FREETALK_CHECK(precision == "float32" || precision == "bfloat16",
                 "precision must be float32 or bfloat16, found ", precision);
}

/// One way of the deformation.
struct Deformation {
  Deformation(DeformationField field, const at::Tensor& z_id, const at::Tensor& anchors,
              bool bfloat16)
      : of_head(field->network()),
        network(field->options().mlp(), nn::layers_of(*field->network()), bfloat16),
        identity_code(plain(field->compress(z_id.unsqueeze(0), anchors.unsqueeze(0)).squeeze(0))),
        out_dim(3 + field->options().hyper_dim) {}

  at::Tensor code(const at::Tensor& z_exp) const { return at::cat({identity_code, plain(z_exp)}); }
  at::Tensor operator()(const at::Tensor& points, const at::Tensor& z_exp) const {
    return run(network, network.fold(code(z_exp)), points, out_dim);
  }
  /// The points that it moves to the given ones.
  at::Tensor inverted(const at::Tensor& points, const at::Tensor& z_exp) const {
    const nn::FoldedCode folded = network.fold(code(z_exp));
    const at::Tensor batch = code(z_exp).unsqueeze(0);
    nn::FieldMlp jacobians = of_head;
    const Offsets offsets{[&](const at::Tensor& x) {
                            const at::Tensor moved =
                                run(network, folded, x.squeeze(0).contiguous(), out_dim);
                            return moved.narrow(1, 0, 3).unsqueeze(0);
                          },
                          [&](const at::Tensor& x) {
                            return jacobians->with_jacobian(x, batch).second.narrow(2, 0, 3);
                          }};
    return invert(offsets, points.unsqueeze(0)).squeeze(0);
  }

  nn::FieldMlp of_head;  // for Jacobians
  nn::PackedFieldMlp network;
  at::Tensor identity_code;  // (identity_code_dim,)
  int64_t out_dim;
};

struct PreparedHead::State {
  State(const ParametricHead& made_of, const at::Tensor& identity, const PreparedOptions& options)
      : head(made_of),
        z_id(plain(identity)),
        anchors(plain(head->anchors(z_id.unsqueeze(0)).squeeze(0))),
        engine(*made_of->identity_field(), anchors, options.precision == "bfloat16") {
    const bool half = options.precision == "bfloat16";
    const HeadOptions& own = head->options();
    if (own.has_backward()) to_canonical.emplace(head->deformation(true), z_id, anchors, half);
    if (own.has_forward()) to_posed.emplace(head->deformation(false), z_id, anchors, half);
    if (own.identity_sees != "expression") codes = fold_members({});
  }

  std::vector<nn::FoldedCode> fold_members(const at::Tensor& z_exp) const {
    const at::Tensor expression = z_exp.defined() ? plain(z_exp).unsqueeze(0) : z_exp;
    return engine.fold(
        head->identity_field()->member_codes(z_id.unsqueeze(0), expression).squeeze(1));
  }

  at::Tensor identity_sdf(const at::Tensor& points, const at::Tensor& z_exp,
                          const at::Tensor& hyper, bool fade) const {
    check_points(points);
    const IdentityOptions& options = head->identity_field()->options();
    at::Tensor inputs = plain(points);
    if (options.hyper_dim > 0) {
      inputs = at::cat(
          {inputs, hyper.defined() ? plain(hyper) : at::zeros({points.size(0), options.hyper_dim})},
          1);
    }
    if (options.expression_dim == 0) return engine.run(inputs, codes, fade);
    const at::Tensor expression =
        z_exp.defined() ? z_exp : at::zeros({options.expression_dim}, at::kFloat);
    return engine.run(inputs, fold_members(expression), fade);
  }

  static void check_points(const at::Tensor& points) {
    FREETALK_CHECK(points.dim() == 2 && points.size(1) == 3,
                   "PreparedHead: expected points (N, 3), found ", points.sizes());
  }
  void check_expression(const at::Tensor& z_exp) const {
    FREETALK_CHECK(z_exp.dim() == 1 && z_exp.size(0) == head->options().expression_dim,
                   "PreparedHead: expected z_exp (", head->options().expression_dim, ",), found ",
                   z_exp.sizes());
    FREETALK_CHECK(z_exp.isfinite().all().item<bool>(),
                   "PreparedHead: z_exp holds numbers that are not finite");
  }

  ParametricHead head;
  at::Tensor z_id, anchors;
  IdentityEngine engine;
  std::vector<nn::FoldedCode> codes;  // of all members, where they do not depend on the expression
  std::optional<Deformation> to_canonical, to_posed;
};

PreparedHead::PreparedHead(const ParametricHead& head, const at::Tensor& z_id,
                           const PreparedOptions& options) {
  options.check();
  FREETALK_CHECK(z_id.dim() == 1 && z_id.size(0) == head->identity_dim(),
                 "PreparedHead: expected z_id (", head->identity_dim(), ",), found ", z_id.sizes());
  FREETALK_CHECK(z_id.isfinite().all().item<bool>(),
                 "PreparedHead: z_id holds numbers that are not finite");
  FREETALK_CHECK(head->rest_expression.is_cpu() && z_id.is_cpu() &&
                     head->rest_expression.scalar_type() == at::kFloat,
                 "PreparedHead: the head and z_id must be on the CPU, the head in float32");
  const at::NoGradGuard no_grad;
  state_ = std::make_shared<const State>(head, z_id, options);
}

at::Tensor PreparedHead::canonical_sdf(const at::Tensor& points, const at::Tensor& z_exp,
                                       const at::Tensor& hyper) const {
  const at::NoGradGuard no_grad;
  return state_->identity_sdf(points, z_exp, hyper, true);
}

at::Tensor PreparedHead::unfaded_sdf(const at::Tensor& points, const at::Tensor& z_exp,
                                     const at::Tensor& hyper) const {
  const at::NoGradGuard no_grad;
  return state_->identity_sdf(points, z_exp, hyper, false);
}

at::Tensor PreparedHead::sdf(const at::Tensor& points, const at::Tensor& z_exp) const {
  const CanonicalPoints canonical = to_canonical(points, z_exp);
  return canonical_sdf(canonical.points, z_exp, canonical.hyper);
}

CanonicalPoints PreparedHead::to_canonical(const at::Tensor& points,
                                           const at::Tensor& z_exp) const {
  const at::NoGradGuard no_grad;
  State::check_points(points);
  state_->check_expression(z_exp);
  if (!state_->to_canonical) {
    return {state_->to_posed->inverted(plain(points), z_exp), {}};
  }
  const Deformation& deformation = *state_->to_canonical;
  const at::Tensor from = plain(points);
  const at::Tensor moved = deformation(from, z_exp);
  CanonicalPoints result{from + moved.narrow(1, 0, 3), {}};
  if (deformation.out_dim > 3) result.hyper = moved.narrow(1, 3, deformation.out_dim - 3);
  return result;
}

at::Tensor PreparedHead::to_posed(const at::Tensor& points, const at::Tensor& z_exp) const {
  const at::NoGradGuard no_grad;
  State::check_points(points);
  state_->check_expression(z_exp);
  const at::Tensor from = plain(points);
  if (!state_->to_posed) return state_->to_canonical->inverted(from, z_exp);
  return from + (*state_->to_posed)(from, z_exp);
}

std::pair<at::Tensor, at::Tensor> PreparedHead::backward_with_jacobian(
    const at::Tensor& points, const at::Tensor& z_exp) const {
  const at::NoGradGuard no_grad;
  State::check_points(points);
  state_->check_expression(z_exp);
  nn::FieldMlp network = state_->head->deformation(true)->network();
  const at::Tensor code = state_->to_canonical->code(z_exp).unsqueeze(0);
  const auto [moved, jacobian] = network->with_jacobian(plain(points).unsqueeze(0), code);
  return {moved.squeeze(0).narrow(1, 0, 3), jacobian.squeeze(0).narrow(1, 0, 3)};
}

const HeadOptions& PreparedHead::options() const { return state_->head->options(); }
const ParametricHead& PreparedHead::head() const { return state_->head; }
const at::Tensor& PreparedHead::z_id() const { return state_->z_id; }
const at::Tensor& PreparedHead::anchors() const { return state_->anchors; }

}  // namespace freetalk::head
