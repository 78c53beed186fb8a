// Sinusoidal codes of integers and reals.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>

namespace freetalk::nn {

/// Sinusoidal code [Vaswani et al. 2017; Ho et al. 2020]: (sin(p w_0..), cos(p w_0..)), w_i =
/// 10000^(-i / (dim/2)).
/// @param positions (N,) any number type.
/// @param dim even number of channels.
/// @returns (N, dim) float32 on the device of `positions`.
at::Tensor sinusoidal_code(const at::Tensor& positions, int64_t dim);

}  // namespace freetalk::nn
