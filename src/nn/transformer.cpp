#include "freetalk/nn/transformer.h"

#include <torch/nn/functional/activation.h>
#include <torch/nn/init.h>

#include "freetalk/core/error.h"

namespace freetalk::nn {

void TransformerLayerOptions::check() const {
  FREETALK_CHECK(d_model > 0 && num_heads > 0 && d_model % num_heads == 0, "d_model (", d_model,
                 ") must be a positive multiple of num_heads (", num_heads, ")");
  FREETALK_CHECK(ff_dim > 0, "ff_dim must be positive, found ", ff_dim);
  FREETALK_CHECK(dropout >= 0 && dropout < 1, "dropout must be in [0, 1), found ", dropout);
  FREETALK_CHECK(activation == "gelu" || activation == "relu",
                 "activation must be gelu or relu, found ", activation);
}

at::Tensor TransformerLayerOptions::activated(const at::Tensor& hidden) const {
  return activation == "gelu" ? at::gelu(hidden) : at::relu(hidden);
}

AttentionHeads::AttentionHeads(int64_t d_model, int64_t num_heads, double dropout)
    : num_heads_(num_heads), dropout_(dropout) {
  in_proj_weight = register_parameter("in_proj_weight", torch::empty({3 * d_model, d_model}));
  in_proj_bias = register_parameter("in_proj_bias", torch::zeros({3 * d_model}));
  out_proj = register_module("out_proj", torch::nn::Linear(d_model, d_model));
  torch::nn::init::xavier_uniform_(in_proj_weight);
  torch::nn::init::zeros_(out_proj->bias);
}

at::Tensor AttentionHeads::attended(const at::Tensor& query, const at::Tensor& keys,
                                    const at::Tensor& values, const at::Tensor& allowed) {
  const c10::optional<at::Tensor> mask =
      allowed.defined() ? c10::make_optional(allowed) : c10::nullopt;
  const at::Tensor heads =
      at::scaled_dot_product_attention(query, keys, values, mask, is_training() ? dropout_ : 0.0);
  return out_proj->forward(heads.transpose(1, 2).flatten(-2));  // (B, T, d)
}

at::Tensor MultiheadAttentionImpl::split_heads(const at::Tensor& x) const {
  return x.unflatten(-1, {num_heads(), x.size(-1) / num_heads()})
      .transpose(1, 2);  // (B, heads, T, d_head)
}

at::Tensor MultiheadAttentionImpl::forward(const at::Tensor& query, const at::Tensor& memory,
                                           const at::Tensor& allowed) {
  const int64_t d = query.size(-1);
  at::Tensor q, k, v;
  if (query.is_same(memory)) {
    const auto parts = at::linear(query, in_proj_weight, in_proj_bias).split(d, -1);
    q = parts[0], k = parts[1], v = parts[2];
  } else {
    q = at::linear(query, in_proj_weight.narrow(0, 0, d), in_proj_bias.narrow(0, 0, d));
    const auto parts =
        at::linear(memory, in_proj_weight.narrow(0, d, 2 * d), in_proj_bias.narrow(0, d, 2 * d))
            .split(d, -1);
    k = parts[0], v = parts[1];
  }
  return attended(split_heads(q), split_heads(k), split_heads(v), allowed);
}

TransformerDecoderLayerImpl::TransformerDecoderLayerImpl(const TransformerLayerOptions& options)
    : options_(options) {
  options.check();
  const int64_t d = options.d_model;
  self_attn_ =
      register_module("self_attn", MultiheadAttention(d, options.num_heads, options.dropout));
  multihead_attn_ =
      register_module("multihead_attn", MultiheadAttention(d, options.num_heads, options.dropout));
  linear1_ = register_module("linear1", torch::nn::Linear(d, options.ff_dim));
  linear2_ = register_module("linear2", torch::nn::Linear(options.ff_dim, d));
  const torch::nn::LayerNormOptions norm_options({d});
  norm1_ = register_module("norm1", torch::nn::LayerNorm(norm_options));
  norm2_ = register_module("norm2", torch::nn::LayerNorm(norm_options));
  norm3_ = register_module("norm3", torch::nn::LayerNorm(norm_options));
  dropout_ = register_module("dropout", torch::nn::Dropout(options.dropout));
}

at::Tensor TransformerDecoderLayerImpl::feed_forward(const at::Tensor& x) {
  return linear2_(dropout_(options_.activated(linear1_(x))));
}

at::Tensor TransformerDecoderLayerImpl::forward(const at::Tensor& x, const at::Tensor& memory,
                                                const at::Tensor& self_allowed,
                                                const at::Tensor& cross_allowed) {
  if (options_.norm_first) {
    const at::Tensor normed = norm1_(x);
    at::Tensor y = x + dropout_(self_attn_(normed, normed, self_allowed));
    y = y + dropout_(multihead_attn_(norm2_(y), memory, cross_allowed));
    return y + dropout_(feed_forward(norm3_(y)));
  }
  at::Tensor y = norm1_(x + dropout_(self_attn_(x, x, self_allowed)));
  y = norm2_(y + dropout_(multihead_attn_(y, memory, cross_allowed)));
  return norm3_(y + dropout_(feed_forward(y)));
}

at::Tensor band_mask(int64_t num_frames, int64_t radius, c10::Device device) {
  const at::Tensor index =
      at::arange(num_frames, at::TensorOptions().dtype(at::kLong).device(device));
  return (index.unsqueeze(0) - index.unsqueeze(1)).abs() <= radius;
}

}  // namespace freetalk::nn
