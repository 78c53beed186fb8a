// Random motion for the tests of metrics.
#pragma once

#include <torch/torch.h>

#include "freetalk/core/random.h"

namespace freetalk::metrics {

/// (B, T, V, 3) float64, about a centimetre.
inline at::Tensor random_motion(uint64_t seed, int64_t batch, int64_t frames, int64_t vertices) {
  return 0.01 * torch::randn({batch, frames, vertices, 3}, core::make_generator(seed),
                             torch::dtype(torch::kDouble));
}

}  // namespace freetalk::metrics
