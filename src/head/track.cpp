#include "freetalk/head/track.h"

#include <torch/torch.h>

#include "freetalk/core/error.h"
#include "freetalk/core/torch_error.h"

namespace freetalk::head {
namespace {

void check_points(const char* name, const at::Tensor& points) {
  FREETALK_CHECK(points.dim() == 2 && points.size(1) == 3, "head: expected ", name,
                 " (V, 3), found ", points.sizes());
  FREETALK_CHECK(points.isfinite().all().item<bool>(), "head: ", name,
                 " hold numbers that are not finite");
}

/// One Newton step of x + delta(x) = canonical, E's residual, where it is short.
at::Tensor newton_step(const PreparedHead& head, const at::Tensor& posed,
                       const at::Tensor& canonical, const at::Tensor& z_exp, double largest) {
  const auto [offsets, jacobian] = head.backward_with_jacobian(posed, z_exp);
  const at::Tensor residual = posed + offsets - canonical;
  const auto [inverse, info] = at::linalg_inv_ex(jacobian + at::eye(3, jacobian.options()));
  const at::Tensor step = inverse.matmul(residual.unsqueeze(-1)).squeeze(-1);
  const at::Tensor taken = info.eq(0).logical_and(step.norm(2, 1) <= largest).unsqueeze(1);
  return posed - at::where(taken, step, at::zeros_like(step));
}

}  // namespace

void TrackOptions::check() const {
  FREETALK_CHECK(newton_steps >= 0, "newton_steps must not be negative, found ", newton_steps);
  FREETALK_CHECK(largest_step_mm > 0, "largest_step_mm must be positive, found ", largest_step_mm);
}

at::Tensor track(const PreparedHead& head, const at::Tensor& template_points,
                 const at::Tensor& z_exp, const std::vector<int64_t>& refined,
                 const TrackOptions& options, const SmoothingOptions& smoothing,
                 const FrameCallback& on_frame) {
  return core::with_plain_errors("track", [&] {
    const at::NoGradGuard no_grad;
    options.check();
    smoothing.check();
    check_points("template_points", template_points);
    FREETALK_CHECK(z_exp.dim() == 2 && z_exp.size(1) == head.options().expression_dim,
                   "track: expected z_exp (T, ", head.options().expression_dim, "), found ",
                   z_exp.sizes());
    const double scale = head.options().units_per_metre;
    const at::Tensor canonical = (template_points.to(at::kFloat) * scale).contiguous();
    const at::Tensor rest = smoothing.mode == "rest"
                                ? head.to_posed(canonical, head.head()->rest_expression) - canonical
                                : at::Tensor();
    const at::Tensor index = at::tensor(refined, at::kLong);
    FREETALK_CHECK(refined.empty() || (index.min().item<int64_t>() >= 0 &&
                                       index.max().item<int64_t>() < canonical.size(0)),
                   "track: refined vertices must be in [0, ", canonical.size(0), ")");
    const bool refines =
        options.newton_steps > 0 && !refined.empty() && head.options().direction == "both";
    const at::Tensor of_refined = canonical.index_select(0, index);
    const int64_t frames = z_exp.size(0);
    at::Tensor result = at::empty({frames, canonical.size(0), 3}, at::kFloat);
    for (int64_t frame = 0; frame < frames; ++frame) {
      at::Tensor posed = head.to_posed(canonical, z_exp[frame]);
      if (refines) {
        at::Tensor moved = posed.index_select(0, index);
        for (int64_t step = 0; step < options.newton_steps; ++step) {
          moved = newton_step(head, moved, of_refined, z_exp[frame],
                              options.largest_step_mm * 1e-3 * scale);
        }
        posed.index_copy_(0, index, moved);
      }
      if (smoothing.mode != "none") {
        posed = canonical + smoothed_offsets(head, canonical, posed - canonical, rest, smoothing);
      }
      at::Tensor to = result[frame];
      at::div_out(to, posed, scale);
      if (on_frame) on_frame(frame + 1, frames);
    }
    return result;
  });
}

at::Tensor canonical_template(const PreparedHead& head, const at::Tensor& vertices,
                              const at::Tensor& z_exp) {
  return core::with_plain_errors("canonical_template", [&] {
    const at::NoGradGuard no_grad;
    check_points("vertices", vertices);
    const double scale = head.options().units_per_metre;
    const at::Tensor rest = z_exp.defined() ? z_exp : head.head()->rest_expression;
    return head.to_canonical(vertices.to(at::kFloat) * scale, rest).points / scale;
  });
}

}  // namespace freetalk::head
