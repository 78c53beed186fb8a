// How the fused decoder's matrices are laid out: float32, padded to what its kernels take at once.
#pragma once

#include <ATen/ATen.h>

#include <cstdint>
#include <vector>

#include "kernels/fused_kernels.h"

namespace freetalk::nn::fused {

using kernels::Epilogue;
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

template <class T>
std::vector<T> rows_of(const Kernels<T>& kernels, const at::Tensor& x) {
  std::vector<T> result(static_cast<size_t>(round_up(x.numel(), 16)));
  const at::Tensor source =
      at::constant_pad_nd(x.reshape({-1}), {0, static_cast<int64_t>(result.size()) - x.numel()});
  kernels.convert(source.const_data_ptr<float>(), source.numel(), result.data());
  return result;
}

/// A (out, in) weight as a packed right operand (in, out), both padded to `columns`.
template <class T>
std::vector<T> packed_weight(const Kernels<T>& kernels, const at::Tensor& weight, int64_t columns) {
  const at::Tensor square = padded(plain(weight), columns, columns).t().contiguous();
  std::vector<T> result(static_cast<size_t>(square.numel()));
  kernels.pack(square.const_data_ptr<float>(), columns, columns, result.data());
  return result;
}

/// (V, K) grouped; K need not be a multiple of the vector.
template <class T>
std::vector<T> grouped_rows(const Kernels<T>& kernels, const at::Tensor& x) {
  const int64_t group = kernels.group, width = x.size(1);
  const std::vector<T> rows = rows_of(kernels, x);
  std::vector<T> result(static_cast<size_t>(x.numel()));
  for (int64_t v = 0; v < x.size(0); ++v) {
    for (int64_t k = 0; k < width; ++k) {
      result[static_cast<size_t>(v / group * group * width + k * group + v % group)] =
          rows[static_cast<size_t>(v * width + k)];
    }
  }
  return result;
}

}  // namespace freetalk::nn::fused
