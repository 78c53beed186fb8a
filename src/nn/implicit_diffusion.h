// Heat diffusion by one implicit Euler step: (M + t_c L) u_c = M x_c for every channel c.
#pragma once

#include <ATen/core/Tensor.h>

#include "freetalk/geometry/operators.h"

namespace freetalk::nn {

/// As `implicit_dense` of the public diffusion_net, but by sparse factors in double on the CPU, one
/// a channel, which need no dense (V, V). Differentiable once in x and time.
/// @param x (B, V, C). @param time (C,) > 0. @returns (B, V, C).
at::Tensor implicit_diffusion(const at::Tensor& x, const at::Tensor& time,
                              const geometry::SurfaceOperators& operators);

}  // namespace freetalk::nn
