#include "freetalk/metrics/samples.h"

#include <ATen/ATen.h>

#include "freetalk/core/error.h"
#include "freetalk/metrics/vertex_error.h"
#include "select.h"

namespace freetalk::metrics {
namespace {

void check_samples(const at::Tensor& samples, int64_t least, const char* metric) {
  FREETALK_CHECK(samples.defined() && samples.dim() == 5 && samples.size(-1) == 3 &&
                     samples.numel() > 0 && samples.is_floating_point(),
                 metric, ": expected samples (N, K, T, V, 3) floating point and not empty, found ",
                 samples.sizes());
  FREETALK_CHECK(samples.size(1) >= least, metric, ": needs ", least, " samples, found ",
                 samples.size(1));
}

}  // namespace

at::Tensor diversity(const at::Tensor& codes) {
  FREETALK_CHECK(codes.defined() && codes.dim() >= 3 && codes.size(1) >= 2 && codes.numel() > 0 &&
                     codes.is_floating_point(),
                 "diversity: expected codes (N, K, ...) floating point with K >= 2, found ",
                 codes.sizes());
  const at::Tensor flat = codes.flatten(2).to(at::kDouble);  // (N, K, D)
  const int64_t count = flat.size(1);
  at::Tensor sum = at::zeros({flat.size(0)}, flat.options());
  for (int64_t j = 0; j < count; ++j) {
    for (int64_t l = j + 1; l < count; ++l) {
      sum += 2 * (flat.select(1, j) - flat.select(1, l)).square().sum(1).sqrt();
    }
  }
  return sum / static_cast<double>(count);
}

at::Tensor diversity_vertex(const at::Tensor& samples, const Selection& selection) {
  check_samples(samples, 2, "diversity_vertex");
  const int64_t count = samples.size(1);
  at::Tensor sum = at::zeros({samples.size(0)}, samples.options().dtype(at::kDouble));
  for (int64_t j = 0; j < count; ++j) {
    for (int64_t l = j + 1; l < count; ++l) {
      sum += mve_mean(samples.select(1, j), samples.select(1, l), selection);
    }
  }
  return sum / (0.5 * static_cast<double>(count * (count - 1)));
}

at::Tensor lve_mean_estimate(const at::Tensor& samples, const at::Tensor& target,
                             const Selection& selection) {
  check_samples(samples, 1, "lve_mean_estimate");
  return lve(samples.mean({1}, /*keepdim=*/false, at::kDouble), target, selection);
}

at::Tensor lve_coverage(const at::Tensor& samples, const at::Tensor& target,
                        const Selection& selection) {
  check_samples(samples, 1, "lve_coverage");
  at::Tensor least;
  for (int64_t k = 0; k < samples.size(1); ++k) {
    const at::Tensor own = lve(samples.select(1, k), target, selection);
    least = k == 0 ? own : at::minimum(least, own);
  }
  return least;
}

}  // namespace freetalk::metrics
