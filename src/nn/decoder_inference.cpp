#include "nn/decoder_inference.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace freetalk::nn {
namespace {

constexpr int64_t kBlockFrames = 16;  // against 2r more keys: few products are wasted at r = 3

/// 0 where frame first + b * size + i may attend to padded key first + b * size + j, else -inf.
at::Tensor band_bias(int64_t num_frames, int64_t radius, int64_t first, int64_t size, int64_t count,
                     const at::TensorOptions& options) {
  const auto whole = options.dtype(at::kLong);
  const at::Tensor start = first + size * at::arange(count, whole).view({-1, 1, 1});
  const at::Tensor frame = start + at::arange(size, whole).view({1, -1, 1});
  const at::Tensor key = start + at::arange(size + 2 * radius, whole).view({1, 1, -1}) - radius;
  const at::Tensor allowed =
      (frame - key).abs().le(radius).logical_and(key.ge(0)).logical_and(key.lt(num_frames));
  return at::zeros(allowed.sizes(), options)
      .masked_fill_(allowed.logical_not(), -std::numeric_limits<double>::infinity())
      .unsqueeze(1);
}

at::Tensor attend(const at::Tensor& q, const at::Tensor& k, const at::Tensor& v,
                  const std::optional<at::Tensor>& bias = std::nullopt) {
  return at::scaled_dot_product_attention(q, k, v, bias);
}

/// The same for bfloat16 on a CPU, where whole products beat the blockwise kernel twice.
at::Tensor attend_whole(const at::Tensor& q, const at::Tensor& k, const at::Tensor& v) {
  const double scale = 1 / std::sqrt(static_cast<double>(q.size(-1)));
  const at::Tensor none = at::empty({1}, q.options());
  const at::Tensor scores = at::baddbmm(none, q, k.transpose(1, 2), /*beta=*/0, scale);
  return at::bmm(at::softmax(scores, -1), v);
}

}  // namespace

BandAttention::BandAttention(int64_t num_frames, int64_t radius, at::ScalarType dtype,
                             c10::Device device)
    : num_frames_(num_frames),
      margin_(std::max<int64_t>(radius, 0)),
      block_(radius < 0 ? 0 : std::min(num_frames, kBlockFrames)) {
  if (block_ == 0) return;
  const auto options = at::TensorOptions().dtype(dtype).device(device);
  const int64_t count = num_frames / block_, rest = num_frames % block_;
  block_bias_ = band_bias(num_frames, radius, 0, block_, count, options);
  if (rest > 0) tail_bias_ = band_bias(num_frames, radius, num_frames - rest, rest, 1, options);
}

at::Tensor BandAttention::blocks(const at::Tensor& query, const at::Tensor& memory,
                                 int64_t num_heads, int64_t first, int64_t size,
                                 const at::Tensor& bias) const {
  const int64_t batch = query.size(0), d = query.size(2), depth = d / num_heads;
  const int64_t count = bias.size(0), keys = size + 2 * margin_;
  const at::Tensor q = query.narrow(1, first, count * size)
                           .reshape({batch * count, size, num_heads, depth})
                           .transpose(1, 2);  // (B blocks, heads, frames, depth)
  const auto split = [&](int64_t offset) {    // overlapping blocks of keys, as a view where B is 1
    return memory
        .as_strided({batch, count, num_heads, keys, depth},
                    {memory.stride(0), size * memory.stride(1), depth, memory.stride(1), 1},
                    memory.storage_offset() + first * memory.stride(1) + offset)
        .reshape({batch * count, num_heads, keys, depth});
  };
  const at::Tensor mask = batch == 1 ? bias : bias.repeat({batch, 1, 1, 1});
  return attend(q, split(0), split(d), mask).transpose(1, 2).reshape({batch, count * size, d});
}

at::Tensor BandAttention::operator()(const at::Tensor& query, const at::Tensor& memory,
                                     int64_t num_heads) const {
  if (block_ == 0) {
    const auto heads = [&](const at::Tensor& x) {
      return x.unflatten(-1, {num_heads, x.size(-1) / num_heads}).transpose(1, 2);
    };
    const auto parts = memory.split(query.size(2), -1);
    return attend(heads(query), heads(parts[0]), heads(parts[1])).transpose(1, 2).flatten(-2);
  }
  const at::Tensor whole = blocks(query, memory, num_heads, 0, block_, block_bias_);
  if (!tail_bias_.defined()) return whole;
  const int64_t rest = num_frames_ % block_;
  return at::cat({whole, blocks(query, memory, num_heads, num_frames_ - rest, rest, tail_bias_)},
                 1);
}

DecoderLayerInference::DecoderLayerInference(const TransformerDecoderLayerImpl& layer,
                                             at::ScalarType dtype, int64_t rows)
    : num_heads_(layer.options_.num_heads),
      norm_first_(layer.options_.norm_first),
      activation_(layer.options_.activation),
      norm1_(copy(layer.norm1_, dtype)),
      norm2_(copy(layer.norm2_, dtype)),
      norm3_(copy(layer.norm3_, dtype)) {
  const int64_t d = layer.options_.d_model;
  const auto pack = [&](const at::Tensor& weight, const at::Tensor& bias) {
    return kernels::FixedLinear(weight, bias, dtype, rows);
  };
  const auto& self = layer.self_attn_;
  const auto& cross = layer.multihead_attn_;
  self_in_ = pack(self->in_proj_weight, self->in_proj_bias);
  self_out_ = pack(self->out_proj->weight, self->out_proj->bias);
  query_ = pack(cross->in_proj_weight.narrow(0, 0, d), cross->in_proj_bias.narrow(0, 0, d));
  key_value_ =
      pack(cross->in_proj_weight.narrow(0, d, 2 * d), cross->in_proj_bias.narrow(0, d, 2 * d));
  cross_out_ = pack(cross->out_proj->weight, cross->out_proj->bias);
  ff_in_ = pack(layer.linear1_->weight, layer.linear1_->bias);
  ff_out_ = pack(layer.linear2_->weight, layer.linear2_->bias);
}

DecoderLayerInference::Norm DecoderLayerInference::copy(const torch::nn::LayerNorm& norm,
                                                        at::ScalarType dtype) {
  return {norm->weight.detach().to(dtype), norm->bias.detach().to(dtype), norm->options.eps()};
}

at::Tensor DecoderLayerInference::apply(const Norm& norm, const at::Tensor& x) {
  return at::layer_norm(x, {x.size(-1)}, norm.weight, norm.bias, norm.eps);
}

at::Tensor DecoderLayerInference::remember(const at::Tensor& memory, int64_t margin) const {
  return at::constant_pad_nd(key_value_(memory), {0, 0, margin, margin}).contiguous();
}

at::Tensor DecoderLayerInference::self_attention(const at::Tensor& x) const {
  const int64_t batch = x.size(0), frames = x.size(1), d = x.size(2);
  const at::Tensor heads = self_in_(x).view({batch, frames, 3, num_heads_, d / num_heads_});
  const auto part = [&](int64_t index) { return heads.select(2, index).transpose(1, 2); };
  const at::Tensor q = part(0), k = part(1), v = part(2);  // (B, heads, T, depth)
  if (!x.is_cpu() || x.scalar_type() != at::kBFloat16) {
    return attend(q, k, v).transpose(1, 2).reshape(x.sizes());
  }
  const at::Tensor result = at::empty_like(x);
  for (int64_t b = 0; b < batch; ++b) {
    result[b].view({frames, num_heads_, -1}).copy_(attend_whole(q[b], k[b], v[b]).transpose(0, 1));
  }
  return result;
}

at::Tensor DecoderLayerInference::cross_attention(const at::Tensor& x, const at::Tensor& memory,
                                                  const std::vector<int64_t>& memory_of,
                                                  const BandAttention& band) const {
  const at::Tensor query = query_(x);
  const auto groups = static_cast<int64_t>(memory_of.size());
  const int64_t size = x.size(0) / groups;
  if (groups == 1) return band(query, memory.narrow(0, memory_of[0] * size, size), num_heads_);
  std::vector<at::Tensor> attended;
  for (int64_t group = 0; group < groups; ++group) {
    const int64_t entry = memory_of[static_cast<size_t>(group)] * size;
    attended.push_back(
        band(query.narrow(0, group * size, size), memory.narrow(0, entry, size), num_heads_));
  }
  return at::cat(attended);
}

at::Tensor DecoderLayerInference::forward(const at::Tensor& x, const at::Tensor& memory,
                                          const std::vector<int64_t>& memory_of,
                                          const BandAttention& band) const {
  if (norm_first_) {
    at::Tensor y = self_out_.add(self_attention(apply(norm1_, x)), x);
    y = cross_out_.add(cross_attention(apply(norm2_, y), memory, memory_of, band), y);
    return ff_out_.add(ff_in_(apply(norm3_, y), activation_), y);
  }
  at::Tensor y = apply(norm1_, self_out_.add(self_attention(x), x));
  y = apply(norm2_, cross_out_.add(cross_attention(y, memory, memory_of, band), y));
  return apply(norm3_, ff_out_.add(ff_in_(y, activation_), y));
}

}  // namespace freetalk::nn
