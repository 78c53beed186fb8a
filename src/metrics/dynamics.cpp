#include "freetalk/metrics/dynamics.h"

#include <ATen/ATen.h>

#include <cmath>

#include "freetalk/core/error.h"
#include "select.h"

namespace freetalk::metrics {
namespace {

/// Standard deviation over valid frames, ddof 0, of |m|^2: (B, T, M, 3) -> (B, M).
at::Tensor spread(const at::Tensor& motion, const at::Tensor& valid) {
  const at::Tensor squared = squared_length(motion);
  const at::Tensor mean = mean_over_frames(squared, valid);  // (B, M)
  return mean_over_frames((squared - mean.unsqueeze(1)).square(), valid).sqrt();
}

struct Steps {
  at::Tensor pred, target;  // (B, T - 1, M, 3) displacement from a frame to the next
  at::Tensor valid;         // (B, T - 1) bool
};

Steps steps_of(const at::Tensor& pred, const at::Tensor& target, const Selection& selection,
               const char* metric) {
  const auto motions = select_motions(pred, target, selection, 2, metric);
  return {motions.pred.diff(1, 1), motions.target.diff(1, 1), valid_runs(motions.valid, 2)};
}

/// 1 - cos of the angle between two vectors, 1 where one is 0, 0 where both are: (..., 3) -> (...).
at::Tensor cosine_distance(const at::Tensor& a, const at::Tensor& b) {
  const at::Tensor first = squared_length(a).sqrt(), second = squared_length(b).sqrt();
  const at::Tensor product = (a * b).sum(-1), lengths = first * second;
  const at::Tensor still = (first + second == 0).to(product.scalar_type());
  return (1 - at::where(lengths > 0, product / lengths, still)).clamp_min(0);  // of rounding
}

at::Tensor squared_jerk(const at::Tensor& motion) { return squared_length(motion.diff(3, 1)); }

}  // namespace

at::Tensor fdd(const at::Tensor& pred, const at::Tensor& target, const Selection& selection) {
  const auto motions = select_motions(pred, target, selection, 1, "fdd");
  return (spread(motions.target, motions.valid) - spread(motions.pred, motions.valid)).mean(1);
}

at::Tensor fdd_abs(const at::Tensor& pred, const at::Tensor& target, const Selection& selection) {
  return fdd(pred, target, selection).abs();
}

at::Tensor delta_m(const at::Tensor& pred, const at::Tensor& target, const Selection& selection) {
  const auto steps = steps_of(pred, target, selection, "delta_m");
  return mean_over_frames(squared_length(steps.pred - steps.target).mean(2), steps.valid);
}

at::Tensor delta_m_l2(const at::Tensor& pred, const at::Tensor& target,
                      const Selection& selection) {
  const auto steps = steps_of(pred, target, selection, "delta_m_l2");
  return mean_over_frames(squared_length(steps.pred - steps.target).sqrt().mean(2), steps.valid);
}

at::Tensor delta_cd(const at::Tensor& pred, const at::Tensor& target, const Selection& selection) {
  const auto steps = steps_of(pred, target, selection, "delta_cd");
  return mean_over_frames(cosine_distance(steps.pred, steps.target).mean(2), steps.valid);
}

at::Tensor delta_cd_weighted(const at::Tensor& pred, const at::Tensor& target,
                             const Selection& selection) {
  const auto steps = steps_of(pred, target, selection, "delta_cd_weighted");
  const at::Tensor weight = squared_length(steps.target).sqrt();
  const at::Tensor sum =
      mean_over_frames((weight * cosine_distance(steps.pred, steps.target)).sum(2), steps.valid);
  const at::Tensor total = mean_over_frames(weight.sum(2), steps.valid);
  return at::where(total > 0, sum / total, at::zeros({}, total.options()));
}

at::Tensor jerk_energy(const at::Tensor& motion, double fps, const Selection& selection) {
  FREETALK_CHECK(fps > 0, "jerk_energy: fps must be above 0, found ", fps);
  check_motion(motion, "jerk_energy", "motion");
  const at::Tensor valid = valid_frames(selection.valid, motion, 4, "jerk_energy");
  const at::Tensor indices = vertex_indices(selection, motion, "jerk_energy");
  const at::Tensor squared = squared_jerk(take_vertices(motion, indices)).mean(2);
  return mean_over_frames(squared, valid_runs(valid, 4)) * std::pow(fps, 6);
}

at::Tensor jitter_ratio(const at::Tensor& pred, const at::Tensor& target,
                        const Selection& selection) {
  const auto motions = select_motions(pred, target, selection, 4, "jitter_ratio");
  const at::Tensor runs = valid_runs(motions.valid, 4);
  const at::Tensor ours = mean_over_frames(squared_jerk(motions.pred).mean(2), runs);
  const at::Tensor truth = mean_over_frames(squared_jerk(motions.target).mean(2), runs);
  const at::Tensor both_smooth = (ours == 0).logical_and(truth == 0);
  return at::where(both_smooth, at::ones({}, ours.options()), ours / truth);
}

}  // namespace freetalk::metrics
