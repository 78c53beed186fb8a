// What the networks on surfaces have in common: values at the vertices in, a linear layer,
// something that may look around on the surface, a linear layer out.
#pragma once

#include <torch/nn/module.h>
#include <torch/nn/modules/linear.h>

#include <memory>

#include "freetalk/geometry/operators.h"

namespace freetalk::nn {

class SurfaceNetImpl : public torch::nn::Module {
 public:
  /// @param x (B, V, in_channels) values at the vertices of one mesh, or of a batch of meshes laid
  ///   one after the other. @returns (B, V, out_channels).
  virtual at::Tensor forward(const at::Tensor& x, const geometry::SurfaceOperators& operators);

  /// What follows the first linear layer: for callers that compute it in parts.
  /// @param hidden (B, V, width).
  virtual at::Tensor forward_hidden(const at::Tensor& hidden,
                                    const geometry::SurfaceOperators& operators) = 0;

  /// From the inputs to the hidden width.
  virtual torch::nn::Linear& first_layer() = 0;
  /// To the outputs.
  virtual torch::nn::Linear& last_layer() = 0;
  /// Whether the eigenbasis is used.
  virtual bool uses_eigenbasis() const { return false; }
};

}  // namespace freetalk::nn
