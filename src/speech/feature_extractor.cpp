#include <torch/torch.h>

#include <cmath>

#include "layers.h"

namespace freetalk::speech {
namespace {

/// Group norm with one channel a group over the real positions alone; x (B, C, L), valid (B,).
at::Tensor masked_instance_norm(const at::Tensor& x, const at::Tensor& valid,
                                const torch::nn::GroupNorm& norm) {
  const auto wide =
      x.to(at::kFloat == x.scalar_type() || at::kDouble == x.scalar_type() ? x.scalar_type()
                                                                           : at::kFloat);
  const auto positions = at::arange(x.size(2), valid.options());
  const auto mask = (positions < valid.view({-1, 1, 1})).to(wide.scalar_type());  // (B, 1, L)
  const auto count = valid.view({-1, 1, 1}).to(wide.scalar_type());
  const auto mean = (wide * mask).sum(2, true) / count;  // (B, C, 1)
  const auto centred = wide - mean;
  const auto variance = (centred.square() * mask).sum(2, true) / count;
  const auto scale = norm->weight.view({1, -1, 1}) * (variance + norm->options.eps()).rsqrt();
  return centred * scale + norm->bias.view({1, -1, 1});
}

}  // namespace

at::Tensor activate(const std::string& name, const at::Tensor& x) {
  if (name == "relu") {
    return at::relu(x);
  }
  return name == "silu" ? at::silu(x) : at::gelu(x);
}

ConvLayerImpl::ConvLayerImpl(const SpeechEncoderOptions& options, size_t index)
    : norm_(options.feat_extract_norm == "layer" ? Norm::kLayer
            : index == 0                         ? Norm::kGroup
                                                 : Norm::kNone),
      activation_(options.feat_extract_activation) {
  const int64_t in_dim = index == 0 ? 1 : options.conv_dim[index - 1];
  const int64_t out_dim = options.conv_dim[index];
  conv_ = register_module("conv", torch::nn::Conv1d(torch::nn::Conv1dOptions(
                                                        in_dim, out_dim, options.conv_kernel[index])
                                                        .stride(options.conv_stride[index])
                                                        .bias(options.conv_bias)));
  if (norm_ == Norm::kGroup) {
    group_norm_ = register_module(
        "layer_norm", torch::nn::GroupNorm(torch::nn::GroupNormOptions(out_dim, out_dim)));
  } else if (norm_ == Norm::kLayer) {
    layer_norm_ =
        register_module("layer_norm", torch::nn::LayerNorm(torch::nn::LayerNormOptions({out_dim})));
  }
}

at::Tensor ConvLayerImpl::forward(const at::Tensor& x, const std::optional<at::Tensor>& valid,
                                  const WindowMoments* moments) {
  if (norm_ == Norm::kGroup && moments != nullptr) {
    const auto folded =
        fold_group_norm(conv_->weight, group_norm_->weight, group_norm_->bias, *moments);
    const auto y = at::conv1d(x, folded.weight.to(x.dtype()), folded.bias.to(x.dtype()),
                              conv_->options.stride()->at(0));
    return activate(activation_, y);
  }
  auto y = conv_->forward(x);
  if (norm_ == Norm::kGroup) {
    y = valid ? masked_instance_norm(y, *valid, group_norm_) : group_norm_->forward(y);
  } else if (norm_ == Norm::kLayer) {
    y = layer_norm_->forward(y.transpose(1, 2)).transpose(1, 2);
  }
  return activate(activation_, y);
}

void ConvLayerImpl::initialize(const SpeechEncoderOptions& options) {
  torch::nn::init::kaiming_normal_(conv_->weight);
  if (conv_->bias.defined()) {
    const double bound =
        1.0 / std::sqrt(static_cast<double>(conv_->weight.size(1) * conv_->weight.size(2)));
    options.model_type == "wav2vec2" ? conv_->bias.uniform_(-bound, bound) : conv_->bias.zero_();
  }
}

FeatureExtractorImpl::FeatureExtractorImpl(const SpeechEncoderOptions& options)
    : mask_group_norm_(options.mask_group_norm && options.feat_extract_norm == "group"),
      first_kernel_(options.conv_kernel[0]),
      first_stride_(options.conv_stride[0]) {
  conv_layers_ = register_module("conv_layers", torch::nn::ModuleList());
  for (size_t i = 0; i < options.conv_dim.size(); ++i) {
    conv_layers_->push_back(std::make_shared<ConvLayerImpl>(options, i));
  }
}

at::Tensor FeatureExtractorImpl::forward(const at::Tensor& wave,
                                         const std::optional<at::Tensor>& lengths,
                                         const WindowMoments* moments) {
  std::optional<at::Tensor> valid;  // of the first layer, the only one with group norm
  if (lengths && mask_group_norm_) {
    valid = at::floor_divide(*lengths - first_kernel_, first_stride_) + 1;
  }
  auto x = wave.unsqueeze(1);  // (B, 1, S)
  for (const auto& layer : *conv_layers_) {
    x = layer->as<ConvLayerImpl>()->forward(x, valid, moments);
  }
  return x.transpose(1, 2);  // (B, S', C_conv)
}

void FeatureExtractorImpl::initialize(const SpeechEncoderOptions& options) {
  for (const auto& layer : *conv_layers_) {
    layer->as<ConvLayerImpl>()->initialize(options);
  }
}

FeatureProjectionImpl::FeatureProjectionImpl(const SpeechEncoderOptions& options)
    : dropout_(options.feat_proj_dropout) {
  const int64_t in_dim = options.conv_dim.back();
  if (options.feat_proj_layer_norm) {
    layer_norm_ = register_module(
        "layer_norm",
        torch::nn::LayerNorm(torch::nn::LayerNormOptions({in_dim}).eps(options.layer_norm_eps)));
  }
  projection_ = register_module("projection", torch::nn::Linear(in_dim, options.hidden_size));
}

at::Tensor FeatureProjectionImpl::forward(const at::Tensor& features) {
  const auto x = layer_norm_ ? layer_norm_->forward(features) : features;
  return at::dropout(projection_->forward(x), dropout_, is_training());
}

void FeatureProjectionImpl::initialize(const SpeechEncoderOptions& options) {
  if (options.model_type == "wav2vec2") {
    const double bound = 1.0 / std::sqrt(static_cast<double>(projection_->weight.size(1)));
    projection_->weight.uniform_(-bound, bound);
    projection_->bias.uniform_(-bound, bound);
  } else {
    projection_->weight.normal_(0.0, options.initializer_range);
    projection_->bias.zero_();
  }
}

}  // namespace freetalk::speech
