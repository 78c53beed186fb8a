#include "freetalk/speech/options.h"

#include <algorithm>

#include "freetalk/core/error.h"

namespace freetalk::speech {
namespace {

void check_one_of(const char* name, const std::string& value,
                  const std::vector<std::string>& allowed) {
  std::string list;
  for (const auto& word : allowed) {
    list += (list.empty() ? "" : ", ") + word;
  }
  FREETALK_CHECK(std::find(allowed.begin(), allowed.end(), value) != allowed.end(), name, " is '",
                 value, "': use one of ", list);
}

void check_positive(const char* name, int64_t value) {
  FREETALK_CHECK(value > 0, name, " is ", value, ": it must be positive");
}

void check_probability(const char* name, double value) {
  FREETALK_CHECK(value >= 0.0 && value < 1.0, name, " is ", value, ": it must be in [0, 1)");
}

}  // namespace

void SpeechEncoderOptions::check() const {
  check_one_of("model_type", model_type, {"hubert", "wav2vec2"});
  check_one_of("hidden_act", hidden_act, {"gelu", "relu", "silu"});
  check_one_of("feat_extract_activation", feat_extract_activation, {"gelu", "relu", "silu"});
  check_one_of("feat_extract_norm", feat_extract_norm, {"group", "layer"});
  check_positive("hidden_size", hidden_size);
  check_positive("num_attention_heads", num_attention_heads);
  check_positive("intermediate_size", intermediate_size);
  check_positive("num_conv_pos_embeddings", num_conv_pos_embeddings);
  check_positive("num_conv_pos_embedding_groups", num_conv_pos_embedding_groups);
  FREETALK_CHECK(num_hidden_layers >= 0, "num_hidden_layers is ", num_hidden_layers,
                 ": it must not be negative");
  FREETALK_CHECK(hidden_size % num_attention_heads == 0, "hidden_size ", hidden_size,
                 " is not divisible by num_attention_heads ", num_attention_heads);
  FREETALK_CHECK(hidden_size % num_conv_pos_embedding_groups == 0, "hidden_size ", hidden_size,
                 " is not divisible by num_conv_pos_embedding_groups ",
                 num_conv_pos_embedding_groups);
  FREETALK_CHECK(!conv_dim.empty() && conv_dim.size() == conv_stride.size() &&
                     conv_dim.size() == conv_kernel.size(),
                 "conv_dim, conv_stride and conv_kernel hold ", conv_dim.size(), ", ",
                 conv_stride.size(), " and ", conv_kernel.size(),
                 " entries: they must be of one length, at least 1");
  for (size_t i = 0; i < conv_dim.size(); ++i) {
    check_positive("conv_dim", conv_dim[i]);
    check_positive("conv_stride", conv_stride[i]);
    check_positive("conv_kernel", conv_kernel[i]);
  }
  FREETALK_CHECK(layer_norm_eps > 0.0, "layer_norm_eps is ", layer_norm_eps,
                 ": it must be positive");
  FREETALK_CHECK(initializer_range > 0.0, "initializer_range is ", initializer_range,
                 ": it must be positive");
  check_probability("hidden_dropout", hidden_dropout);
  check_probability("attention_dropout", attention_dropout);
  check_probability("activation_dropout", activation_dropout);
  check_probability("feat_proj_dropout", feat_proj_dropout);
  check_probability("layerdrop", layerdrop);
}

SpeechEncoderOptions hubert_base() { return {}; }

SpeechEncoderOptions hubert_large() {
  SpeechEncoderOptions options;
  options.hidden_size = 1024;
  options.num_hidden_layers = 24;
  options.num_attention_heads = 16;
  options.intermediate_size = 4096;
  options.do_stable_layer_norm = true;
  options.feat_extract_norm = "layer";
  options.conv_bias = true;
  return options;
}

SpeechEncoderOptions wav2vec2_base() {
  SpeechEncoderOptions options;
  options.model_type = "wav2vec2";
  return options;
}

SpeechEncoderOptions hubert_xlarge() {
  auto options = hubert_large();
  options.hidden_size = 1280;
  options.num_hidden_layers = 48;
  options.intermediate_size = 5120;
  return options;
}

SpeechEncoderOptions wav2vec2_large() {
  auto options = wav2vec2_base();
  options.hidden_size = 1024;
  options.num_hidden_layers = 24;
  options.num_attention_heads = 16;
  options.intermediate_size = 4096;
  return options;
}

SpeechEncoderOptions wav2vec2_large_lv60() {
  auto options = hubert_large();
  options.model_type = "wav2vec2";
  return options;
}

SpeechEncoderOptions hubert_tiny() {
  SpeechEncoderOptions options;
  options.conv_dim = {64, 96, 96, 128, 128, 160, 192};
  options.hidden_size = 192;
  options.num_hidden_layers = 4;
  options.num_attention_heads = 4;
  options.intermediate_size = 768;
  options.num_conv_pos_embeddings = 64;
  options.activation_dropout = 0.0;
  options.mask_group_norm = true;
  return options;
}

}  // namespace freetalk::speech
