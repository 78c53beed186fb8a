#include "head/fit_residuals.h"

#include <torch/torch.h>

#include <algorithm>

#include "freetalk/core/error.h"

namespace freetalk::head {
namespace {

constexpr int64_t kRowsAtOnce = 1000;  // points that have codes of their own

/// A code for each of `count` points.
at::Tensor of_each(const at::Tensor& code, int64_t count) {
  return code.detach().unsqueeze(0).expand({count, code.size(0)});
}

/// Distances of points with codes of their own: a batch of one point each.
at::Tensor distances(ParametricHeadImpl& head, const at::Tensor& points, const at::Tensor& z_id,
                     const at::Tensor& z_exp) {
  return head.forward(points.unsqueeze(1), z_id, z_exp).squeeze(1);
}

/// The same where the identity is one: its anchors are placed and its code compressed once.
at::Tensor distances_of_one(ParametricHeadImpl& head, const at::Tensor& points,
                            const at::Tensor& z_id, const at::Tensor& z_exp) {
  const at::Tensor identity = z_id.unsqueeze(0);
  DeformationField field = head.deformation(true);
  nn::FieldMlp network = field->network();
  const at::Tensor compressed = field->compress(identity, head.anchors(identity)).detach();
  const at::Tensor codes = at::cat({compressed.expand({points.size(0), -1}), z_exp}, 1);
  const at::Tensor moved = network->forward(points.unsqueeze(1), codes).squeeze(1);
  const at::Tensor canonical = (points + moved.narrow(1, 0, 3)).unsqueeze(0);
  const int64_t hyper = moved.size(1) - 3;
  return head
      .canonical_sdf(canonical, identity, {},
                     hyper > 0 ? moved.narrow(1, 3, hyper).unsqueeze(0) : at::Tensor())
      .squeeze(0);
}

}  // namespace

Linearized linearize_expression(ParametricHeadImpl& head, const at::Tensor& points,
                                const at::Tensor& z_id, const at::Tensor& z_exp) {
  const bool one = head.options().has_backward() && head.options().identity_sees != "expression";
  std::vector<at::Tensor> distance, jacobian;
  for (const at::Tensor& some : points.split(kRowsAtOnce)) {
    const at::AutoGradMode recording(true);
    const at::Tensor codes = of_each(z_exp, some.size(0)).contiguous().requires_grad_();
    const at::Tensor s = one ? distances_of_one(head, some, z_id, codes)
                             : distances(head, some, of_each(z_id, some.size(0)), codes);
    jacobian.push_back(torch::autograd::grad({s.sum()}, {codes})[0]);
    distance.push_back(s.detach());
  }
  return {at::cat(distance), at::cat(jacobian)};
}

Linearized linearize_both(ParametricHeadImpl& head, const at::Tensor& points,
                          const at::Tensor& z_id, const at::Tensor& z_exp) {
  std::vector<at::Tensor> distance, jacobian;
  for (const at::Tensor& some : points.split(kRowsAtOnce)) {
    const at::AutoGradMode recording(true);
    const at::Tensor identity = of_each(z_id, some.size(0)).contiguous().requires_grad_();
    const at::Tensor expression = of_each(z_exp, some.size(0)).contiguous().requires_grad_();
    const at::Tensor s = distances(head, some, identity, expression);
    const auto gradients = torch::autograd::grad({s.sum()}, {identity, expression});
    jacobian.push_back(at::cat({gradients[0], gradients[1]}, 1));
    distance.push_back(s.detach());
  }
  return {at::cat(distance), at::cat(jacobian)};
}

at::Tensor draw_points(const at::Tensor& points, int64_t count, double units_per_metre,
                       at::Generator& generator) {
  const at::Tensor scaled = points.detach().to(at::kFloat) * units_per_metre;
  if (count == 0 || count >= scaled.size(0)) return scaled;
  const at::Tensor order = at::randperm(scaled.size(0), generator, at::kLong);
  return scaled.index_select(0, order.narrow(0, 0, count));
}

void check_frames(const std::vector<at::Tensor>& points) {
  FREETALK_CHECK(!points.empty(), "fit: expected the points of at least one frame");
  for (size_t frame = 0; frame < points.size(); ++frame) {
    const at::Tensor& own = points[frame];
    FREETALK_CHECK(own.dim() == 2 && own.size(1) == 3 && own.size(0) > 0,
                   "fit: expected points (P, 3) of frame ", frame, ", found ", own.sizes());
    FREETALK_CHECK(own.isfinite().all().item<bool>(), "fit: points of frame ", frame,
                   " hold numbers that are not finite");
  }
}

}  // namespace freetalk::head
