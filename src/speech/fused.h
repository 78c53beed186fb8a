// Layers for inference on a CPU: products and convolutions by the oneDNN kernels inside LibTorch,
// with bias and activation in the same pass. For where has_fused_kernels() says so.
#pragma once

#include <ATen/core/Tensor.h>

#include <optional>
#include <string>

namespace freetalk::speech {

/// Whether the fused kernels can be had for this type on this machine.
bool has_fused_kernels(at::ScalarType dtype);

/// x -> activation(x Wᵀ + b), rows of x may overlap or lie apart.
/// @param x (N, C_in), unit stride along C_in
/// @param activation "gelu", "relu", "silu", or "" for none
at::Tensor fused_linear(const at::Tensor& x, const at::Tensor& weight,
                        const std::optional<at::Tensor>& bias, const std::string& activation = "");

/// A linear layer in the type that it computes in. Of that type already: shares the weights.
class FusedLinear {
 public:
  FusedLinear(const at::Tensor& weight, const at::Tensor& bias, at::ScalarType dtype);
  at::Tensor operator()(const at::Tensor& x, const std::string& activation = "") const;

 private:
  at::Tensor weight_, bias_;
};

/// A grouped convolution over (L, C_in), channels last; keeps a copy of the weights in the layout
/// of the kernel.
class FusedConv {
 public:
  struct Shape {
    int64_t stride = 1, padding = 0, groups = 1;
  };
  /// @param weight (C_out, C_in / groups, kernel)
  /// @param bias (C_out,) or undefined
  FusedConv(const at::Tensor& weight, const at::Tensor& bias, Shape shape, at::ScalarType dtype);
  /// (L, C_in) -> (L', C_out), contiguous
  at::Tensor operator()(const at::Tensor& x, const std::string& activation = "") const;

 private:
  at::Tensor weight_, bias_;
  Shape shape_;
};

}  // namespace freetalk::speech
