// A linear layer with fixed weights, for inference: on a CPU the weights are laid out once as
// oneDNN's kernels want them (twice as fast as at::linear in float32 on AVX-512), with activation
// and residual fused into the product. On other devices, and where oneDNN is missing, at::linear.
#pragma once

#include <ATen/core/Tensor.h>
#include <c10/core/ScalarType.h>

#include <string>

namespace freetalk::kernels {

class PackedLinear {
 public:
  PackedLinear() = default;
  /// @param weight (out, in). @param bias (out,). @param dtype of the products, float32 or
  /// bfloat16.
  /// @param rows how many vectors a call usually holds: the layout is chosen for it.
  PackedLinear(const at::Tensor& weight, const at::Tensor& bias, at::ScalarType dtype,
               int64_t rows);

  /// act(x W^T + b). @param x (..., in) of `dtype`. @param activation "none", "gelu" or "relu".
  at::Tensor operator()(const at::Tensor& x, const std::string& activation = "none") const;
  /// residual + x W^T + b. @param residual (..., out).
  at::Tensor add(const at::Tensor& x, const at::Tensor& residual) const;

 private:
  at::Tensor weight_, bias_, packed_;  // weight_ is kept only where nothing is packed
};

}  // namespace freetalk::kernels
