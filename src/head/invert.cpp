#include "head/invert.h"

#include <torch/torch.h>

namespace freetalk::head {
namespace {

constexpr int kSteps = 15;           // [NPHM's code]
constexpr double kConverged = 1e-6;  // head units: a quarter of a micrometre; float32's end
constexpr double kConvergedInDouble = 1e-12;
constexpr double kSmallest = 1e-12;  // of Broyden's denominators

at::Tensor times(const at::Tensor& matrix, const at::Tensor& vector) {
  return matrix.matmul(vector.unsqueeze(-1)).squeeze(-1);
}

/// (I + d delta / dx)^-1 (B, N, 3, 3).
at::Tensor inverse_jacobian(const Offsets& offsets, const at::Tensor& points) {
  const at::Tensor jacobian = offsets.jacobian(points);
  return std::get<0>(at::linalg_inv_ex(jacobian + at::eye(3, jacobian.options())));
}

at::Tensor solve(const Offsets& offsets, const at::Tensor& target) {
  const at::NoGradGuard no_grad;
  at::Tensor x = target - offsets.value(target);
  at::Tensor inverse = inverse_jacobian(offsets, x);
  at::Tensor residual = x + offsets.value(x) - target;
  at::Tensor best = x, error = residual.norm(2, -1, true);
  const double enough = target.scalar_type() == at::kDouble ? kConvergedInDouble : kConverged;
  for (int step = 0; step < kSteps && error.max().item<double>() > enough; ++step) {
    const at::Tensor dx = -times(inverse, residual);
    x = x + dx;
    const at::Tensor next = x + offsets.value(x) - target;
    const at::Tensor image = times(inverse, next - residual);
    const at::Tensor row = times(inverse.transpose(-1, -2), dx);
    at::Tensor scale = (dx * image).sum(-1, true);
    scale = at::where(scale.abs() < kSmallest, at::full_like(scale, kSmallest), scale);
    inverse = inverse + ((dx - image) / scale).unsqueeze(-1) * row.unsqueeze(-2);
    residual = next;
    const at::Tensor found = residual.norm(2, -1, true);
    const at::Tensor better = found < error;
    best = at::where(better, x, best);
    error = at::where(better, found, error);
  }
  return best;
}

}  // namespace

at::Tensor invert(const Offsets& offsets, const at::Tensor& target) {
  const at::Tensor found = solve(offsets, target);
  if (!at::GradMode::is_enabled()) return found;
  at::Tensor inverse;
  {
    const at::NoGradGuard no_grad;
    inverse = inverse_jacobian(offsets, found);
  }
  return found - times(inverse, found + offsets.value(found) - target);
}

}  // namespace freetalk::head
