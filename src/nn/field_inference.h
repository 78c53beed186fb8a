// A coordinate network with its weights packed for the CPU's kernels: for inference over many
// points under one code. Equal to FieldMlp up to rounding; coordinates and the last layer stay in
// float32 where hidden channels are bfloat16.
#pragma once

#include <ATen/core/Tensor.h>

#include <memory>
#include <utility>
#include <vector>

#include "freetalk/nn/field_mlp.h"

namespace freetalk::nn {

/// What a code adds to the layers that see it.
struct FoldedCode {
  std::vector<float> first, skip;  // as wide as the layers, padded
};

class PackedFieldMlp {
 public:
  using Layers = std::vector<std::pair<at::Tensor, at::Tensor>>;  // weight (out, in), bias (out,)

  /// @param bfloat16 hidden channels in bfloat16, where the processor multiplies them; else
  /// float32.
  PackedFieldMlp(const FieldMlpOptions& options, const Layers& layers, bool bfloat16);
  PackedFieldMlp(PackedFieldMlp&&) noexcept;
  ~PackedFieldMlp();

  /// @param code (code_dim,) float32.
  FoldedCode fold(const at::Tensor& code) const;
  /// On the calling thread; safe to use from several. @param points (count, point_dim), row-major.
  /// @param result (count, out_dim).
  void run(const float* points, int64_t count, const FoldedCode& code, float* result) const;

  class Engine;

 private:
  std::unique_ptr<Engine> engine_;
};

/// The weights of a network, and of each network of an ensemble.
PackedFieldMlp::Layers layers_of(const FieldMlpImpl& network);
std::vector<PackedFieldMlp::Layers> layers_of(const EnsembledFieldMlpImpl& ensemble);

}  // namespace freetalk::nn
