// How the fused decoder's matrices are laid out: float32, padded to what its kernels take at once.
#pragma once

#include <ATen/ATen.h>

#include <cstdint>

#include "kernels/fused_kernels.h"

namespace freetalk::nn::fused {

using kernels::Epilogue;
using kernels::GradientRows;
using kernels::Kernels;
using kernels::kTile;
using kernels::Segment;

inline int64_t round_up(int64_t value, int64_t multiple) {
  return (value + multiple - 1) / multiple * multiple;
}

inline at::Tensor plain(const at::Tensor& x) { return x.detach().to(at::kFloat).contiguous(); }

/// (R, C) with zeros to (rows, columns).
inline at::Tensor padded(const at::Tensor& x, int64_t rows, int64_t columns) {
  at::Tensor result = at::zeros({rows, columns}, at::kFloat);
  result.narrow(0, 0, x.size(0)).narrow(1, 0, x.size(1)).copy_(x);
  return result;
}

}  // namespace freetalk::nn::fused
