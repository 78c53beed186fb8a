#include "freetalk/nn/embedding.h"

#include <ATen/ATen.h>

#include <cmath>

#include "freetalk/core/error.h"

namespace freetalk::nn {

at::Tensor sinusoidal_code(const at::Tensor& positions, int64_t dim) {
  FREETALK_CHECK(dim > 0 && dim % 2 == 0, "sinusoidal_code: dim must be even and positive, found ",
                 dim);
  FREETALK_CHECK(positions.dim() == 1, "sinusoidal_code: expected positions (N,), found ",
                 positions.sizes());
  const int64_t half = dim / 2;
  const auto options = at::TensorOptions().dtype(at::kFloat).device(positions.device());
  const at::Tensor frequencies =
      at::exp(at::arange(half, options) * (-std::log(10000.0) / static_cast<double>(half)));
  const at::Tensor angles =
      positions.to(at::kFloat).unsqueeze(1) * frequencies.unsqueeze(0);  // (N, dim/2)
  return at::cat({angles.sin(), angles.cos()}, 1);
}

}  // namespace freetalk::nn
