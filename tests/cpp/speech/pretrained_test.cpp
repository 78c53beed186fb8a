#include "freetalk/speech/pretrained.h"

#include <gtest/gtest.h>
#include <torch/torch.h>

#include <unistd.h>

#include <functional>

#include "core/file.h"
#include "freetalk/core/safetensors.h"

namespace freetalk::speech {
namespace {

SpeechEncoderOptions pretrained_options() {
  SpeechEncoderOptions options;
  options.conv_dim = std::vector<int64_t>(7, 8);
  options.hidden_size = 16;
  options.num_hidden_layers = 1;
  options.num_attention_heads = 2;
  options.intermediate_size = 32;
  options.num_conv_pos_embeddings = 8;
  options.num_conv_pos_embedding_groups = 4;
  return options;
}

class Pretrained : public ::testing::Test {
 protected:
  void SetUp() override {
    dir_ = std::filesystem::temp_directory_path() /
           ("freetalk_pretrained_" + std::to_string(::getpid()));
    torch::manual_seed(2);
    encoder_ = SpeechEncoder(pretrained_options());
    encoder_->eval();
    save_speech_encoder(encoder_, dir_);
  }
  void TearDown() override { std::filesystem::remove_all(dir_); }

  /// Rewrites the weights under other names.
  void rename(const std::function<std::string(std::string)>& name) {
    core::TensorMap renamed;
    for (const auto& [key, tensor] : core::load_safetensors(weights())) {
      renamed[name(key)] = tensor.clone();
    }
    core::save_safetensors(weights(), renamed);
  }

  std::filesystem::path weights() const { return dir_ / "model.safetensors"; }

  /// What the loaded encoder computes.
  at::Tensor loaded_output() {
    const torch::NoGradGuard no_grad;
    return load_speech_encoder(dir_)->forward(wave_);
  }
  at::Tensor output() {
    const torch::NoGradGuard no_grad;
    return encoder_->forward(wave_);
  }
  std::string load_error() {
    try {
      load_speech_encoder(dir_);
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return "";
  }

  std::filesystem::path dir_;
  SpeechEncoder encoder_{nullptr};
  at::Tensor wave_ = at::randn({1, 4000});
};

TEST_F(Pretrained, RoundTripIsExact) { EXPECT_TRUE(loaded_output().equal(output())); }

TEST_F(Pretrained, HalfIsCloseAndLoadsAsFloat) {
  save_speech_encoder(encoder_, dir_, /*half=*/true);
  EXPECT_EQ(load_speech_encoder(dir_)->parameters().front().scalar_type(), at::kFloat);
  // weights rounded to 11 bits
  EXPECT_TRUE(loaded_output().allclose(output(), 1e-2, 1e-2));
}

TEST_F(Pretrained, AcceptsPrefixHeadsAndOldWeightNormNames) {
  rename([](std::string key) {
    for (const auto& [now, before] : {std::pair<std::string, std::string>{"original0", "weight_g"},
                                      {"original1", "weight_v"}}) {
      const auto at = key.find("parametrizations.weight." + now);
      if (at != std::string::npos) {
        key = key.substr(0, at) + before;
      }
    }
    return "wav2vec2." + key;
  });
  auto tensors = core::load_safetensors(weights());
  core::TensorMap more;
  for (const auto& [key, tensor] : tensors) {
    more[key] = tensor.clone();
  }
  more["lm_head.weight"] = at::zeros({3, 16});
  more["wav2vec2.masked_spec_embed"] = at::zeros({16});
  core::save_safetensors(weights(), more);
  EXPECT_TRUE(loaded_output().equal(output()));
}

TEST_F(Pretrained, ReadsShards) {
  core::TensorMap first, second;
  for (const auto& [key, tensor] : core::load_safetensors(weights())) {
    (key.find("encoder.layers") == 0 ? first : second)[key] = tensor.clone();
  }
  core::save_safetensors(dir_ / "a.safetensors", first);
  core::save_safetensors(dir_ / "b.safetensors", second);
  std::filesystem::remove(weights());
  core::write_file_atomic(
      dir_ / "model.safetensors.index.json",
      std::string(R"({"weight_map": {"x": "a.safetensors", "y": "b.safetensors"}})"));
  EXPECT_TRUE(loaded_output().equal(output()));
}

TEST_F(Pretrained, NamesMissingAndMisshapedTensors) {
  const std::string key = "encoder.layers.0.attention.k_proj.bias";
  rename([&](const std::string& name) { return name == key ? "surprise" : name; });
  EXPECT_NE(load_error().find(key), std::string::npos);
  EXPECT_NE(load_error().find("surprise"), std::string::npos);
  auto options = pretrained_options();
  options.intermediate_size = 48;
  const SpeechEncoder other(options);
  save_speech_encoder(other, dir_ / "other");
  std::filesystem::copy_file(dir_ / "other" / "model.safetensors", weights(),
                             std::filesystem::copy_options::overwrite_existing);
  rename([](const std::string& name) {
    return name;
  });  // as written by others: no copy of the options
  EXPECT_NE(load_error().find("encoder.layers.0.feed_forward.intermediate_dense.weight"),
            std::string::npos);
}

TEST_F(Pretrained, AStopBetweenItsFilesLeavesTheNewEncoder) {
  const std::string before = core::read_text(dir_ / "config.json");
  auto options = pretrained_options();
  options.intermediate_size = 48;
  encoder_ = SpeechEncoder(options);
  encoder_->eval();
  save_speech_encoder(encoder_, dir_);
  core::write_file_atomic(dir_ / "config.json", before);
  EXPECT_TRUE(loaded_output().equal(output()));
}

TEST_F(Pretrained, NamesWhatIsWrongWithTheFolder) {
  std::filesystem::remove(weights());
  EXPECT_NE(load_error().find("model.safetensors"), std::string::npos);
  core::write_file_atomic(dir_ / "config.json", std::string("{"));
  EXPECT_NE(load_error().find("config.json"), std::string::npos);
  std::filesystem::remove_all(dir_);
  EXPECT_NE(load_error().find(dir_.string()), std::string::npos);
}

TEST(OptionsFromConfig, PassesOverOtherKeysAndRefusesOtherArchitectures) {
  const auto options = options_from_config(
      R"({"model_type": "wav2vec2", "hidden_size": 96, "hidden_dropout": 0, "vocab_size": 32,
          "hidden_act": "swish", "feat_proj_layer_norm": false, "adapter_attn_dim": null})",
      "config.json");
  EXPECT_EQ(options.model_type, "wav2vec2");
  EXPECT_EQ(options.hidden_size, 96);
  EXPECT_EQ(options.hidden_dropout, 0.0);
  EXPECT_EQ(options.hidden_act, "silu");
  EXPECT_TRUE(options.feat_proj_layer_norm);
  for (const char* text : {R"({"model_type": "whisper"})", R"({})", R"([])", R"({"model_type": 3})",
                           R"({"model_type": "hubert", "conv_pos_batch_norm": true})",
                           R"({"model_type": "wav2vec2", "add_adapter": true})",
                           R"({"model_type": "hubert", "hidden_size": "big"})",
                           R"({"model_type": "hubert", "hidden_size": 7})"}) {
    EXPECT_THROW(options_from_config(text, "config.json"), std::runtime_error) << text;
  }
}

}  // namespace
}  // namespace freetalk::speech
