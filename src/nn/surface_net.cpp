#include "freetalk/nn/surface_net.h"

#include <torch/torch.h>

#include "freetalk/core/error.h"

namespace freetalk::nn {

at::Tensor SurfaceNetImpl::forward(const at::Tensor& x,
                                   const geometry::SurfaceOperators& operators) {
  const int64_t channels = first_layer()->options.in_features();
  FREETALK_CHECK(x.dim() == 3 && x.size(1) == operators.num_vertices() && x.size(2) == channels,
                 "expected values at the vertices (B, ", operators.num_vertices(), ", ", channels,
                 "), found ", x.sizes());
  return forward_hidden(first_layer()(x), operators);
}

}  // namespace freetalk::nn
