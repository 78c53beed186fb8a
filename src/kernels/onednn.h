// Layers with fixed weights, for inference on a CPU: products and convolutions by the oneDNN
// kernels inside LibTorch, with bias, activation and residual in the same pass.
//
// Activations are "gelu" (by erf), "relu", "silu", or "" for none.
#pragma once

#include <ATen/core/Tensor.h>
#include <c10/core/ScalarType.h>

#include <optional>
#include <string>

namespace freetalk::kernels {

/// Whether the kernels can be had for this type, float32 or bfloat16, on this machine.
bool has_onednn(at::ScalarType dtype);

/// x -> activation(x W^T + b) where has_onednn(); rows of x may overlap or lie apart.
/// @param x (N, C_in), unit stride along C_in.
at::Tensor onednn_linear(const at::Tensor& x, const at::Tensor& weight,
                         const std::optional<at::Tensor>& bias, const std::string& activation = "");

/// A linear layer in the type that it computes in; at::linear where oneDNN is missing, and on other
/// devices.
class FixedLinear {
 public:
  FixedLinear() = default;
  /// @param weight (out, in). @param bias (out,). Of `dtype` already: they are shared.
  /// @param rows how many vectors a call usually holds: a copy of the weights is laid out for so
  /// many, once, which is twice as fast in float32 on AVX-512. 0: no copy, calls of any size.
  FixedLinear(const at::Tensor& weight, const at::Tensor& bias, at::ScalarType dtype,
              int64_t rows = 0);

  /// activation(x W^T + b). @param x (..., in) of `dtype`.
  at::Tensor operator()(const at::Tensor& x, const std::string& activation = "") const;
  /// residual + x W^T + b. @param residual (..., out).
  at::Tensor add(const at::Tensor& x, const at::Tensor& residual) const;

 private:
  at::Tensor weight_, bias_;
  bool fused_ = false;  // by oneDNN, the weight perhaps in a layout that only it reads
};

/// A grouped convolution over (L, C_in), channels last, where has_onednn(); keeps a copy of the
/// weights in the layout of the kernel.
class FixedConv {
 public:
  struct Shape {
    int64_t stride = 1, padding = 0, groups = 1;
  };
  /// @param weight (C_out, C_in / groups, kernel). @param bias (C_out,) or undefined.
  FixedConv(const at::Tensor& weight, const at::Tensor& bias, Shape shape, at::ScalarType dtype);
  /// (L, C_in) -> (L', C_out), contiguous.
  at::Tensor operator()(const at::Tensor& x, const std::string& activation = "") const;

 private:
  at::Tensor weight_, bias_;
  Shape shape_;
};

}  // namespace freetalk::kernels
