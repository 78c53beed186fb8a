// Transformer decoder layer with masks of any shape; parameter names equal
// torch.nn.TransformerDecoderLayer's.
#pragma once

#include <torch/nn/module.h>
#include <torch/nn/modules/dropout.h>
#include <torch/nn/modules/linear.h>
#include <torch/nn/modules/normalization.h>
#include <torch/nn/pimpl.h>

namespace freetalk::nn {

struct TransformerLayerOptions {
  int64_t d_model = 512;
  int64_t num_heads = 8;
  int64_t ff_dim = 2048;
  double dropout = 0.1;
  bool norm_first = false;          // false: post-norm as in Vaswani et al.
  std::string activation = "gelu";  // "gelu" or "relu"
  void check() const;
};

/// Multi-head scaled dot-product attention, softmax(Q K^T / sqrt(d_head)) V [FreeTalk Eq. 7-10].
class MultiheadAttentionImpl : public torch::nn::Module {
 public:
  MultiheadAttentionImpl(int64_t d_model, int64_t num_heads, double dropout);

  /// @param query (B, T, d). @param memory (B, S, d). @param allowed bool, broadcastable to (B,
  /// heads, T, S); true
  ///   where attention may go; undefined: everywhere.
  at::Tensor forward(const at::Tensor& query, const at::Tensor& memory, const at::Tensor& allowed);

  int64_t num_heads() const { return num_heads_; }

  at::Tensor in_proj_weight, in_proj_bias;  // (3d, d), (3d,): q, k, v
  torch::nn::Linear out_proj{nullptr};

 private:
  at::Tensor split_heads(const at::Tensor& x) const;
  int64_t num_heads_;
  double dropout_;
};
TORCH_MODULE(MultiheadAttention);

/// Self-attention, cross-attention, feed-forward, each with residual and layer norm.
class TransformerDecoderLayerImpl : public torch::nn::Module {
 public:
  explicit TransformerDecoderLayerImpl(const TransformerLayerOptions& options);

  /// @param x (B, T, d). @param memory (B, S, d). @param self_allowed, cross_allowed as in
  /// MultiheadAttention.
  at::Tensor forward(const at::Tensor& x, const at::Tensor& memory, const at::Tensor& self_allowed,
                     const at::Tensor& cross_allowed);

  MultiheadAttention& self_attention() { return self_attn_; }
  MultiheadAttention& cross_attention() { return multihead_attn_; }

 private:
  friend class DecoderLayerInference;  // reads the weights once and packs them
  at::Tensor feed_forward(const at::Tensor& x);

  TransformerLayerOptions options_;
  MultiheadAttention self_attn_{nullptr}, multihead_attn_{nullptr};
  torch::nn::Linear linear1_{nullptr}, linear2_{nullptr};
  torch::nn::LayerNorm norm1_{nullptr}, norm2_{nullptr}, norm3_{nullptr};
  torch::nn::Dropout dropout_{nullptr};
};
TORCH_MODULE(TransformerDecoderLayer);

/// Attention allowed where |i - j| <= radius [FreeTalk Eq. 9; -inf outside, see papers.md]: (T, T)
/// bool.
at::Tensor band_mask(int64_t num_frames, int64_t radius, c10::Device device);

}  // namespace freetalk::nn
