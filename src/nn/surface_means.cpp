#include "nn/surface_means.h"

#include <torch/torch.h>

namespace freetalk::nn {

at::Tensor weighted_means(const at::Tensor& x, const geometry::SurfaceOperators& operators) {
  const at::Tensor mass = operators.mass.to(x.scalar_type()).unsqueeze(1);
  const auto mean = [&](int64_t first, int64_t count) {
    const at::Tensor weights = mass.narrow(0, first, count);
    return (x.narrow(1, first, count) * weights).sum(1, /*keepdim=*/true) / weights.sum();
  };
  if (operators.offsets.empty()) return mean(0, x.size(1));
  std::vector<at::Tensor> means;
  for (size_t mesh = 0; mesh + 1 < operators.offsets.size(); ++mesh) {
    means.push_back(
        mean(operators.offsets[mesh], operators.offsets[mesh + 1] - operators.offsets[mesh]));
  }
  return at::cat(means, 1);
}

at::Tensor at_vertices(const at::Tensor& x, const geometry::SurfaceOperators& operators) {
  if (operators.offsets.empty()) return x;
  const at::Tensor ends = at::tensor(operators.offsets, at::kLong);
  return x.repeat_interleave(ends.diff().to(x.device()), 1, operators.num_vertices());
}

}  // namespace freetalk::nn
