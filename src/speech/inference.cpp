#include "inference.h"

#include <torch/torch.h>

#include <algorithm>
#include <cmath>

#include "core/parallel.h"
#include "fast_scope.h"
#include "layers.h"

namespace freetalk::speech {
namespace {

/// Values of the first convolution worked on at once: a share of the last level cache.
constexpr int64_t kScratchValues = 1 << 21;

/// One head of attention over one clip: softmax(q kᵀ) v, q scaled already; (T, C / heads) each.
at::Tensor attend_head(const at::Tensor& q, const at::Tensor& k, const at::Tensor& v) {
  const auto weights = at::softmax(kernels::onednn_linear(q, k, std::nullopt), -1);
  return kernels::onednn_linear(weights, v.t().contiguous(), std::nullopt);
}

}  // namespace

at::Tensor InferenceEncoder::Norm::operator()(const at::Tensor& x) const {
  return at::layer_norm(x, weight.sizes(), weight, bias, eps);
}

InferenceEncoder::InferenceEncoder(const SpeechEncoderOptions& options,
                                   const std::map<std::string, at::Tensor>& state,
                                   at::ScalarType dtype)
    : options_(options), dtype_(dtype) {
  const auto tensor = [&](const std::string& name) { return state.at(name).detach(); };
  const auto norm = [&](const std::string& name, double eps) {
    return Norm{tensor(name + ".weight").to(at::kFloat), tensor(name + ".bias").to(at::kFloat),
                eps};
  };
  const auto linear = [&](const std::string& name) {
    return kernels::FixedLinear(tensor(name + ".weight"), tensor(name + ".bias"), dtype);
  };
  for (size_t i = 0; i < options.conv_dim.size(); ++i) {
    const std::string name = "feature_extractor.conv_layers." + std::to_string(i);
    const auto bias = options.conv_bias ? tensor(name + ".conv.bias") : at::Tensor();
    ConvLayer layer;
    if (i == 0) {
      first_weight_ = tensor(name + ".conv.weight").to(at::kFloat);
      first_bias_ = bias.defined() ? bias.to(at::kFloat) : bias;
    } else {
      const kernels::FixedConv::Shape shape{options.conv_stride[i], 0, 1};
      layer.conv.emplace(tensor(name + ".conv.weight"), bias, shape, dtype);
    }
    if (options.feat_extract_norm == "layer" || i == 0) {
      layer.norm = norm(name + ".layer_norm", 1e-5);
    }
    conv_layers_.push_back(std::move(layer));
    receptive_field_ += (options.conv_kernel[i] - 1) * stride_;
    stride_ *= options.conv_stride[i];
  }
  if (options.feat_proj_layer_norm) {
    projection_norm_ = norm("feature_projection.layer_norm", options.layer_norm_eps);
  }
  projection_ = linear("feature_projection.projection");
  const std::string conv = "encoder.pos_conv_embed.conv.";
  positions_.emplace(at::_weight_norm(tensor(conv + "parametrizations.weight.original1"),
                                      tensor(conv + "parametrizations.weight.original0"), 2),
                     tensor(conv + "bias"),
                     kernels::FixedConv::Shape{1, options.num_conv_pos_embeddings / 2,
                                               options.num_conv_pos_embedding_groups},
                     dtype);
  encoder_norm_ = norm("encoder.layer_norm", options.layer_norm_eps);
  for (int64_t i = 0; i < options.num_hidden_layers; ++i) {
    const std::string name = "encoder.layers." + std::to_string(i) + ".";
    layers_.push_back({linear(name + "attention.q_proj"), linear(name + "attention.k_proj"),
                       linear(name + "attention.v_proj"), linear(name + "attention.out_proj"),
                       linear(name + "feed_forward.intermediate_dense"),
                       linear(name + "feed_forward.output_dense"),
                       norm(name + "layer_norm", options.layer_norm_eps),
                       norm(name + "final_layer_norm", options.layer_norm_eps)});
  }
}

at::Tensor InferenceEncoder::first_layer(const at::Tensor& wave, const at::Tensor& weight,
                                         const at::Tensor& bias) const {
  const int64_t kernel = options_.conv_kernel[0], stride = options_.conv_stride[0];
  const int64_t count = (wave.size(0) - kernel) / stride + 1;
  const auto windows = wave.as_strided({count, kernel}, {stride, 1});  // (L, k), overlapping rows
  const auto& activation = options_.feat_extract_activation;
  const auto bias_or_none = bias.defined() ? std::optional<at::Tensor>(bias) : std::nullopt;
  if (options_.feat_extract_norm == "group") {  // the norm is in the weights
    return kernels::onednn_linear(windows, weight.squeeze(1), bias_or_none, activation).to(dtype_);
  }
  const auto y = kernels::onednn_linear(windows, weight.squeeze(1), bias_or_none);
  return activate(activation, (*conv_layers_[0].norm)(y)).to(dtype_);
}

at::Tensor InferenceEncoder::conv_layer(const at::Tensor& x, size_t index) const {
  const auto& layer = conv_layers_[index];
  if (!layer.norm) {
    return (*layer.conv)(x, options_.feat_extract_activation);
  }
  const auto y = (*layer.norm)((*layer.conv)(x).to(at::kFloat));
  return activate(options_.feat_extract_activation, y).to(dtype_);
}

at::Tensor InferenceEncoder::extract(const at::Tensor& wave,
                                     const std::optional<WindowMoments>& moments) const {
  auto weight = first_weight_, bias = first_bias_;
  if (moments) {
    const auto& norm = *conv_layers_[0].norm;
    const auto folded = fold_group_norm(first_weight_, norm.weight, norm.bias, *moments);
    weight = folded.weight;
    bias = folded.bias;
  }
  const int64_t count = (wave.size(0) - receptive_field_) / stride_ + 1;
  const int64_t values_per_frame = stride_ / options_.conv_stride[0] * options_.conv_dim[0];
  const int64_t block = std::clamp<int64_t>(kScratchValues / values_per_frame, 16, 4096);
  const auto result = at::empty({count, options_.conv_dim.back()}, wave.options().dtype(dtype_));
  for (int64_t first = 0; first < count; first += block) {
    const int64_t frames = std::min(block, count - first);
    auto x = first_layer(wave.narrow(0, first * stride_, (frames - 1) * stride_ + receptive_field_),
                         weight, bias);
    for (size_t i = 1; i < conv_layers_.size(); ++i) {
      x = conv_layer(x, i);
    }
    result.narrow(0, first, frames).copy_(x);
  }
  return result;
}

at::Tensor InferenceEncoder::add_positions(const at::Tensor& x,
                                           const std::vector<int64_t>& lengths) const {
  const auto result = at::empty_like(x);
  const auto narrow = x.to(dtype_);
  int64_t first = 0;
  for (const int64_t length : lengths) {
    // An even kernel gives one frame too many.
    const auto y = (*positions_)(narrow.narrow(0, first, length), options_.feat_extract_activation);
    auto part = result.narrow(0, first, length);
    at::add_out(part, x.narrow(0, first, length), y.narrow(0, 0, length));
    first += length;
  }
  return result;
}

at::Tensor InferenceEncoder::attend(const Layer& layer, const at::Tensor& x,
                                    const std::vector<int64_t>& lengths) const {
  const int64_t width = options_.hidden_size / options_.num_attention_heads;
  const auto q = layer.q(x).mul_(1.0 / std::sqrt(static_cast<double>(width)));
  const auto k = layer.k(x), v = layer.v(x);
  const auto result = at::empty_like(q);
  int64_t first = 0;
  for (const int64_t length : lengths) {
    // Heads side by side, each on one thread: no waiting for one another within a layer.
    core::parallel_for(0, options_.num_attention_heads, 1, [&](int64_t begin, int64_t end) {
      const FastScope scope;
      for (int64_t head = begin; head < end; ++head) {
        const auto part = [&](const at::Tensor& y) {
          return y.narrow(0, first, length).narrow(1, head * width, width);
        };
        part(result).copy_(attend_head(part(q), part(k).contiguous(), part(v)));
      }
    });
    first += length;
  }
  return layer.out(result);
}

at::Tensor InferenceEncoder::apply_layer(const Layer& layer, const at::Tensor& x,
                                         const std::vector<int64_t>& lengths) const {
  const auto feed_forward = [&](const at::Tensor& y) {
    return layer.down(layer.up(y.to(dtype_), options_.hidden_act));
  };
  if (options_.do_stable_layer_norm) {
    const auto y = x + attend(layer, layer.attention_norm(x).to(dtype_), lengths);
    return y + feed_forward(layer.final_norm(y));
  }
  const auto y = layer.attention_norm(x + attend(layer, x.to(dtype_), lengths));
  return layer.final_norm(y + feed_forward(y));
}

at::Tensor InferenceEncoder::encode(const at::Tensor& features, const std::vector<int64_t>& lengths,
                                    int64_t layer, std::vector<at::Tensor>* states) const {
  auto x = features;
  if (projection_norm_) {
    x = (*projection_norm_)(x.to(at::kFloat));
  }
  x = (*projection_)(x.to(dtype_)).to(at::kFloat);
  x = add_positions(x, lengths);
  if (!options_.do_stable_layer_norm) {
    x = encoder_norm_(x);
  }
  for (int64_t i = 0; i < layer; ++i) {
    if (states != nullptr) {
      states->push_back(x);
    }
    x = apply_layer(layers_[static_cast<size_t>(i)], x, lengths);
  }
  if (options_.do_stable_layer_norm && layer == options_.num_hidden_layers) {
    x = encoder_norm_(x);
  }
  if (states != nullptr) {
    states->push_back(x);
  }
  return x;
}

}  // namespace freetalk::speech
