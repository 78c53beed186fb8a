// The parts of the encoder, each with the parameter names of `transformers`.
#pragma once

#include <torch/nn/modules/container/modulelist.h>
#include <torch/nn/modules/conv.h>
#include <torch/nn/modules/linear.h>
#include <torch/nn/modules/normalization.h>

#include <optional>
#include <string>
#include <vector>

#include "freetalk/speech/options.h"
#include "statistics.h"

namespace freetalk::speech {

at::Tensor activate(const std::string& name, const at::Tensor& x);

/// One strided convolution, optional norm, activation: (B, C_in, L) -> (B, C_out, L').
class ConvLayerImpl : public torch::nn::Module {
 public:
  ConvLayerImpl(const SpeechEncoderOptions& options, size_t index);
  /// @param valid (B,) int64 real output positions, or nothing when all are
  /// @param moments of the wave, for group norm with other statistics than those of x
  at::Tensor forward(const at::Tensor& x, const std::optional<at::Tensor>& valid,
                     const WindowMoments* moments = nullptr);
  void initialize(const SpeechEncoderOptions& options);

 private:
  enum class Norm { kNone, kGroup, kLayer };
  Norm norm_;
  std::string activation_;
  torch::nn::Conv1d conv_{nullptr};
  torch::nn::GroupNorm group_norm_{nullptr};
  torch::nn::LayerNorm layer_norm_{nullptr};
};

class FeatureExtractorImpl : public torch::nn::Module {
 public:
  explicit FeatureExtractorImpl(const SpeechEncoderOptions& options);
  /// (B, S) -> (B, S', C_conv). `lengths` (B,) int64 real samples. `moments` as in ConvLayer.
  at::Tensor forward(const at::Tensor& wave, const std::optional<at::Tensor>& lengths,
                     const WindowMoments* moments = nullptr);
  void initialize(const SpeechEncoderOptions& options);

 private:
  bool mask_group_norm_;
  int64_t first_kernel_, first_stride_;
  torch::nn::ModuleList conv_layers_{nullptr};
};

class FeatureProjectionImpl : public torch::nn::Module {
 public:
  explicit FeatureProjectionImpl(const SpeechEncoderOptions& options);
  at::Tensor forward(const at::Tensor& features);  // (B, S', C_conv) -> (B, S', C)
  void initialize(const SpeechEncoderOptions& options);

 private:
  double dropout_;
  torch::nn::LayerNorm layer_norm_{nullptr};
  torch::nn::Linear projection_{nullptr};
};

/// Grouped convolution over frames with weight norm over its taps: w = g v / |v|, |v| per tap.
class PositionalConvImpl : public torch::nn::Module {
 public:
  explicit PositionalConvImpl(const SpeechEncoderOptions& options);
  at::Tensor forward(const at::Tensor& x);  // (B, S', C) -> (B, S', C)
  void initialize();

 private:
  int64_t kernel_, groups_;
  std::string activation_;
  at::Tensor g_, v_, bias_;
};

class AttentionImpl : public torch::nn::Module {
 public:
  explicit AttentionImpl(const SpeechEncoderOptions& options);
  /// `key_mask` (B, 1, 1, S') bool, true where a frame may be attended to.
  at::Tensor forward(const at::Tensor& x, const std::optional<at::Tensor>& key_mask);

 private:
  int64_t num_heads_;
  double dropout_;
  torch::nn::Linear k_proj_{nullptr}, v_proj_{nullptr}, q_proj_{nullptr}, out_proj_{nullptr};
};

class FeedForwardImpl : public torch::nn::Module {
 public:
  explicit FeedForwardImpl(const SpeechEncoderOptions& options);
  at::Tensor forward(const at::Tensor& x);

 private:
  std::string activation_;
  double activation_dropout_, hidden_dropout_;
  torch::nn::Linear intermediate_dense_{nullptr}, output_dense_{nullptr};
};

class TransformerLayerImpl : public torch::nn::Module {
 public:
  explicit TransformerLayerImpl(const SpeechEncoderOptions& options);
  at::Tensor forward(const at::Tensor& x, const std::optional<at::Tensor>& key_mask);

 private:
  bool norm_first_;
  double dropout_;
  std::shared_ptr<AttentionImpl> attention_;
  std::shared_ptr<FeedForwardImpl> feed_forward_;
  torch::nn::LayerNorm layer_norm_{nullptr}, final_layer_norm_{nullptr};
};

class TransformerImpl : public torch::nn::Module {
 public:
  explicit TransformerImpl(const SpeechEncoderOptions& options);
  /// @param valid_frames (B,) int64, or nothing when all are real
  /// @param layer hidden state to stop at, in [0, num_hidden_layers]
  /// @param states takes hidden states 0 ... layer where it is not null
  at::Tensor forward(at::Tensor x, const std::optional<at::Tensor>& valid_frames, int64_t layer,
                     std::vector<at::Tensor>* states = nullptr);
  void initialize(const SpeechEncoderOptions& options);

 private:
  bool norm_first_;
  double dropout_, layerdrop_;
  std::shared_ptr<PositionalConvImpl> pos_conv_embed_;
  torch::nn::LayerNorm layer_norm_{nullptr};
  torch::nn::ModuleList layers_{nullptr};
};

}  // namespace freetalk::speech
