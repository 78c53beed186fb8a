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
  /// What the feed-forward network's first layer gives, through its activation.
  at::Tensor activated(const at::Tensor& hidden) const;
};

/// What attentions share: projections named and begun as torch.nn.MultiheadAttention's.
class AttentionHeads : public torch::nn::Module {
 public:
  AttentionHeads(int64_t d_model, int64_t num_heads, double dropout);

  int64_t num_heads() const { return num_heads_; }

  at::Tensor in_proj_weight, in_proj_bias;  // (3d, d), (3d,): q, k, v
  torch::nn::Linear out_proj{nullptr};

 protected:
  /// softmax(Q K^T / sqrt(d_head)) V of (B, heads, T or S, d_head), put together: (B, T, d).
  at::Tensor attended(const at::Tensor& query, const at::Tensor& keys, const at::Tensor& values,
                      const at::Tensor& allowed);

 private:
  int64_t num_heads_;
  double dropout_;
};

/// Multi-head scaled dot-product attention [FreeTalk Eq. 7-10].
class MultiheadAttentionImpl : public AttentionHeads {
 public:
  using AttentionHeads::AttentionHeads;

  /// @param query (B, T, d). @param memory (B, S, d). @param allowed bool, broadcastable to (B,
  /// heads, T, S); true
  ///   where attention may go; undefined: everywhere.
  at::Tensor forward(const at::Tensor& query, const at::Tensor& memory, const at::Tensor& allowed);

 private:
  at::Tensor split_heads(const at::Tensor& x) const;
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
