#include "freetalk/metrics/vertex_error.h"

#include <ATen/ATen.h>

#include "select.h"

namespace freetalk::metrics {
namespace {

struct SquaredErrors {
  at::Tensor values;  // (B, T, M) float64
  at::Tensor valid;   // (B, T) bool
};

SquaredErrors squared_errors(const at::Tensor& pred, const at::Tensor& target,
                             const Selection& selection, const char* metric) {
  const auto motions = select_motions(pred, target, selection, 1, metric);
  return {squared_length(motions.pred - motions.target), motions.valid};
}

at::Tensor mean_of_greatest(const SquaredErrors& errors, bool squared) {
  const at::Tensor greatest = errors.values.amax(2);  // (B, T)
  return mean_over_frames(squared ? greatest : greatest.sqrt(), errors.valid);
}

}  // namespace

at::Tensor lve(const at::Tensor& pred, const at::Tensor& target, const Selection& selection) {
  return mean_of_greatest(squared_errors(pred, target, selection, "lve"), true);
}

at::Tensor lve_l2(const at::Tensor& pred, const at::Tensor& target, const Selection& selection) {
  return mean_of_greatest(squared_errors(pred, target, selection, "lve_l2"), false);
}

at::Tensor mve_mean(const at::Tensor& pred, const at::Tensor& target, const Selection& selection) {
  const auto errors = squared_errors(pred, target, selection, "mve_mean");
  return mean_over_frames(errors.values.sqrt().mean(2), errors.valid);
}

at::Tensor mve_max(const at::Tensor& pred, const at::Tensor& target, const Selection& selection) {
  return mean_of_greatest(squared_errors(pred, target, selection, "mve_max"), false);
}

}  // namespace freetalk::metrics
