// A stack of TransformerDecoderLayers at inference, called many times with one memory, as diffusion
// sampling does: weights are packed once, keys and values of the memory are computed once, and
// cross-attention to a band touches the 2r + 1 keys of a frame's band only. Equal to the layers in
// eval mode up to rounding.
#pragma once

#include <ATen/core/Tensor.h>
#include <c10/core/ScalarType.h>

#include <string>
#include <vector>

#include "freetalk/nn/transformer.h"
#include "kernels/onednn.h"

namespace freetalk::nn {

/// Cross-attention of T queries to T keys within |i - j| <= radius, block of frames by block.
class BandAttention {
 public:
  /// @param radius r; negative: every key.
  BandAttention(int64_t num_frames, int64_t radius, at::ScalarType dtype, c10::Device device);

  /// Zero frames that keys and values carry at both ends.
  int64_t margin() const { return margin_; }
  /// @param query (B, T, d). @param memory (B, T + 2 margin, 2d): keys, then values.
  /// @returns (B, T, d).
  at::Tensor operator()(const at::Tensor& query, const at::Tensor& memory, int64_t num_heads) const;

 private:
  at::Tensor blocks(const at::Tensor& query, const at::Tensor& memory, int64_t num_heads,
                    int64_t first, int64_t size, const at::Tensor& bias) const;

  int64_t num_frames_, margin_, block_;
  at::Tensor block_bias_, tail_bias_;  // (blocks, 1, frames, keys): 0 in the band, -inf outside
};

/// One layer with its weights packed.
class DecoderLayerInference {
 public:
  DecoderLayerInference(const TransformerDecoderLayerImpl& layer, at::ScalarType dtype,
                        int64_t rows);

  /// Keys and values of a memory (M, T, d): (M, T + 2 margin, 2d).
  at::Tensor remember(const at::Tensor& memory, int64_t margin) const;
  /// @param x (groups * M, T, d). @param memory (M', T + 2 margin, 2d), M' a multiple of M.
  /// @param memory_of which M entries of `memory` each group of x attends to.
  at::Tensor forward(const at::Tensor& x, const at::Tensor& memory,
                     const std::vector<int64_t>& memory_of, const BandAttention& band) const;

 private:
  struct Norm {
    at::Tensor weight, bias;
    double eps = 1e-5;
  };
  static Norm copy(const torch::nn::LayerNorm& norm, at::ScalarType dtype);
  static at::Tensor apply(const Norm& norm, const at::Tensor& x);
  at::Tensor self_attention(const at::Tensor& x) const;
  at::Tensor cross_attention(const at::Tensor& x, const at::Tensor& memory,
                             const std::vector<int64_t>& memory_of,
                             const BandAttention& band) const;

  int64_t num_heads_;
  bool norm_first_;
  std::string activation_;
  kernels::FixedLinear self_in_, self_out_, query_, key_value_, cross_out_, ff_in_, ff_out_;
  Norm norm1_, norm2_, norm3_;
};

}  // namespace freetalk::nn
