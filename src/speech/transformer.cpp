#include <torch/torch.h>

#include <cmath>

#include "layers.h"

namespace freetalk::speech {
namespace {

torch::nn::LayerNorm make_layer_norm(const SpeechEncoderOptions& options) {
  return torch::nn::LayerNorm(
      torch::nn::LayerNormOptions({options.hidden_size}).eps(options.layer_norm_eps));
}

}  // namespace

PositionalConvImpl::PositionalConvImpl(const SpeechEncoderOptions& options)
    : kernel_(options.num_conv_pos_embeddings),
      groups_(options.num_conv_pos_embedding_groups),
      activation_(options.feat_extract_activation) {
  const int64_t width = options.hidden_size;
  // Containers without a forward: they only give the parameters the names of torch's own
  // parametrisation.
  auto conv = register_module("conv", std::make_shared<torch::nn::Module>("Conv1d"));
  auto parametrizations =
      conv->register_module("parametrizations", std::make_shared<torch::nn::Module>("ModuleDict"));
  auto weight = parametrizations->register_module(
      "weight", std::make_shared<torch::nn::Module>("ParametrizationList"));
  bias_ = conv->register_parameter("bias", torch::zeros({width}));
  g_ = weight->register_parameter("original0", torch::ones({1, 1, kernel_}));
  v_ = weight->register_parameter("original1", torch::ones({width, width / groups_, kernel_}));
}

at::Tensor PositionalConvImpl::forward(const at::Tensor& x) {
  const auto weight = at::_weight_norm(v_, g_, 2);
  auto y = at::conv1d(x.transpose(1, 2), weight, bias_, 1, kernel_ / 2, 1, groups_);
  if (kernel_ % 2 == 0) {
    y = y.narrow(2, 0, y.size(2) - 1);  // an even kernel gives one frame too many
  }
  return activate(activation_, y).transpose(1, 2);
}

void PositionalConvImpl::initialize() {
  const double taps = static_cast<double>(kernel_ * v_.size(0));
  v_.normal_(0.0, 2.0 / std::sqrt(taps));
  g_.copy_(at::norm_except_dim(v_, 2, 2));
}

AttentionImpl::AttentionImpl(const SpeechEncoderOptions& options)
    : num_heads_(options.num_attention_heads), dropout_(options.attention_dropout) {
  const int64_t width = options.hidden_size;
  k_proj_ = register_module("k_proj", torch::nn::Linear(width, width));
  v_proj_ = register_module("v_proj", torch::nn::Linear(width, width));
  q_proj_ = register_module("q_proj", torch::nn::Linear(width, width));
  out_proj_ = register_module("out_proj", torch::nn::Linear(width, width));
}

at::Tensor AttentionImpl::forward(const at::Tensor& x, const std::optional<at::Tensor>& key_mask) {
  const auto split = [&](const at::Tensor& y) {  // (B, S', C) -> (B, heads, S', C / heads)
    return y.view({y.size(0), y.size(1), num_heads_, -1}).transpose(1, 2);
  };
  const auto attended = at::scaled_dot_product_attention(
      split(q_proj_->forward(x)), split(k_proj_->forward(x)), split(v_proj_->forward(x)), key_mask,
      is_training() ? dropout_ : 0.0);
  return out_proj_->forward(attended.transpose(1, 2).flatten(2));
}

FeedForwardImpl::FeedForwardImpl(const SpeechEncoderOptions& options)
    : activation_(options.hidden_act),
      activation_dropout_(options.activation_dropout),
      hidden_dropout_(options.hidden_dropout) {
  intermediate_dense_ = register_module(
      "intermediate_dense", torch::nn::Linear(options.hidden_size, options.intermediate_size));
  output_dense_ = register_module(
      "output_dense", torch::nn::Linear(options.intermediate_size, options.hidden_size));
}

at::Tensor FeedForwardImpl::forward(const at::Tensor& x) {
  auto y = activate(activation_, intermediate_dense_->forward(x));
  y = at::dropout(y, activation_dropout_, is_training());
  return at::dropout(output_dense_->forward(y), hidden_dropout_, is_training());
}

TransformerLayerImpl::TransformerLayerImpl(const SpeechEncoderOptions& options)
    : norm_first_(options.do_stable_layer_norm), dropout_(options.hidden_dropout) {
  attention_ = register_module("attention", std::make_shared<AttentionImpl>(options));
  layer_norm_ = register_module("layer_norm", make_layer_norm(options));
  feed_forward_ = register_module("feed_forward", std::make_shared<FeedForwardImpl>(options));
  final_layer_norm_ = register_module("final_layer_norm", make_layer_norm(options));
}

at::Tensor TransformerLayerImpl::forward(const at::Tensor& x,
                                         const std::optional<at::Tensor>& key_mask) {
  const auto attend = [&](const at::Tensor& y) {
    return at::dropout(attention_->forward(y, key_mask), dropout_, is_training());
  };
  if (norm_first_) {
    const auto y = x + attend(layer_norm_->forward(x));
    return y + feed_forward_->forward(final_layer_norm_->forward(y));
  }
  const auto y = layer_norm_->forward(x + attend(x));
  return final_layer_norm_->forward(y + feed_forward_->forward(y));
}

TransformerImpl::TransformerImpl(const SpeechEncoderOptions& options)
    : norm_first_(options.do_stable_layer_norm),
      dropout_(options.hidden_dropout),
      layerdrop_(options.layerdrop) {
  pos_conv_embed_ =
      register_module("pos_conv_embed", std::make_shared<PositionalConvImpl>(options));
  layer_norm_ = register_module("layer_norm", make_layer_norm(options));
  layers_ = register_module("layers", torch::nn::ModuleList());
  for (int64_t i = 0; i < options.num_hidden_layers; ++i) {
    layers_->push_back(std::make_shared<TransformerLayerImpl>(options));
  }
}

at::Tensor TransformerImpl::forward(at::Tensor x, const std::optional<at::Tensor>& valid_frames,
                                    int64_t layer, std::vector<at::Tensor>* states) {
  std::optional<at::Tensor> key_mask;
  if (valid_frames) {
    const auto mask = at::arange(x.size(1), valid_frames->options()) < valid_frames->view({-1, 1});
    x = x.masked_fill(mask.logical_not().unsqueeze(2), 0.0);
    key_mask = mask.view({x.size(0), 1, 1, x.size(1)});
  }
  x = x + pos_conv_embed_->forward(x);
  if (!norm_first_) {
    x = layer_norm_->forward(x);
  }
  x = at::dropout(x, dropout_, is_training());
  for (int64_t i = 0; i < layer; ++i) {
    if (states != nullptr) {
      states->push_back(x);
    }
    if (is_training() && layerdrop_ > 0.0 && at::rand({}).item<double>() < layerdrop_) {
      continue;
    }
    x = layers_->ptr<TransformerLayerImpl>(static_cast<size_t>(i))->forward(x, key_mask);
  }
  if (norm_first_ && layer == static_cast<int64_t>(layers_->size())) {
    x = layer_norm_->forward(x);
  }
  if (states != nullptr) {
    states->push_back(x);
  }
  return x;
}

void TransformerImpl::initialize(const SpeechEncoderOptions& options) {
  pos_conv_embed_->initialize();
  for (const auto& module : layers_->modules(/*include_self=*/false)) {
    if (auto* linear = module->as<torch::nn::Linear>()) {
      linear->weight.normal_(0.0, options.initializer_range);
      linear->bias.zero_();
    }
  }
}

}  // namespace freetalk::speech
