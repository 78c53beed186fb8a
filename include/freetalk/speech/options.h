// Options of the HuBERT / wav2vec 2.0 encoder. Names and meaning are those of a Hugging Face
// `config.json`.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace freetalk::speech {

/// The rate that every encoder of this family hears, in Hz.
inline constexpr int64_t kSampleRateHz = 16000;

/// Defaults are those of `hubert-base-ls960` except `layerdrop`, which is off.
struct SpeechEncoderOptions {
  std::string model_type = "hubert";  // "hubert" or "wav2vec2": same network, other initial values

  // Transformer.
  int64_t hidden_size = 768;  // C
  int64_t num_hidden_layers = 12;
  int64_t num_attention_heads = 12;  // divides hidden_size
  int64_t intermediate_size = 3072;  // width of the feed-forward part
  std::string hidden_act = "gelu";   // "gelu", "relu" or "silu"
  double layer_norm_eps = 1e-5;
  bool do_stable_layer_norm = false;  // true: norm before each part (large), false: after it (base)

  // Convolutional feature extractor, lists of equal length.
  std::vector<int64_t> conv_dim = {512, 512, 512, 512, 512, 512, 512};
  std::vector<int64_t> conv_stride = {5, 2, 2, 2, 2, 2, 2};
  std::vector<int64_t> conv_kernel = {10, 3, 3, 3, 3, 2, 2};
  bool conv_bias = false;
  std::string feat_extract_norm = "group";  // "group": first layer only; "layer": every layer
  std::string feat_extract_activation = "gelu";
  bool feat_proj_layer_norm = true;

  // Convolutional positions.
  int64_t num_conv_pos_embeddings = 128;       // kernel in frames
  int64_t num_conv_pos_embedding_groups = 16;  // divides hidden_size

  // Probabilities in [0, 1) while training; 0 disables.
  double hidden_dropout = 0.1;
  double attention_dropout = 0.1;
  double activation_dropout = 0.1;
  double feat_proj_dropout = 0.0;
  double layerdrop = 0.0;  // a whole layer is skipped

  double initializer_range = 0.02;  // standard deviation of fresh linear weights

  // Not in `transformers`. true: with a mask, group norm takes its statistics from the real samples
  // alone, so that a padded clip gives what it gives alone. false: from all samples, as the
  // reference does. No effect without a mask.
  bool mask_group_norm = false;

  template <class V>
  void fields(V& v) {
    v("model_type", model_type);
    v("hidden_size", hidden_size);
    v("num_hidden_layers", num_hidden_layers);
    v("num_attention_heads", num_attention_heads);
    v("intermediate_size", intermediate_size);
    v("hidden_act", hidden_act);
    v("layer_norm_eps", layer_norm_eps);
    v("do_stable_layer_norm", do_stable_layer_norm);
    v("conv_dim", conv_dim);
    v("conv_stride", conv_stride);
    v("conv_kernel", conv_kernel);
    v("conv_bias", conv_bias);
    v("feat_extract_norm", feat_extract_norm);
    v("feat_extract_activation", feat_extract_activation);
    v("feat_proj_layer_norm", feat_proj_layer_norm);
    v("num_conv_pos_embeddings", num_conv_pos_embeddings);
    v("num_conv_pos_embedding_groups", num_conv_pos_embedding_groups);
    v("hidden_dropout", hidden_dropout);
    v("attention_dropout", attention_dropout);
    v("activation_dropout", activation_dropout);
    v("feat_proj_dropout", feat_proj_dropout);
    v("layerdrop", layerdrop);
    v("initializer_range", initializer_range);
    v("mask_group_norm", mask_group_norm);
  }

  /// @throws std::invalid_argument naming the option at fault.
  void check() const;
};

/// `facebook/hubert-base-ls960`: 94.4 M parameters.
SpeechEncoderOptions hubert_base();
/// `facebook/hubert-large-ll60k`: 315 M parameters, layer norm extractor, stable layer norm.
SpeechEncoderOptions hubert_large();
/// `facebook/hubert-xlarge-ll60k`: 962 M parameters, as large but wider and deeper.
SpeechEncoderOptions hubert_xlarge();
/// `facebook/wav2vec2-base`: 94.4 M parameters.
SpeechEncoderOptions wav2vec2_base();
/// `facebook/wav2vec2-large`: 315 M parameters, group norm and norms after each part as in base.
SpeechEncoderOptions wav2vec2_large();
/// `facebook/wav2vec2-large-lv60`, `facebook/wav2vec2-large-xlsr-53`: 315 M parameters, layer norm
/// extractor, stable layer norm.
SpeechEncoderOptions wav2vec2_large_lv60();
/// A small HuBERT (about 2.5 M parameters, C = 192) for two CPU cores; frame rule and receptive
/// field as base.
SpeechEncoderOptions hubert_tiny();

}  // namespace freetalk::speech
