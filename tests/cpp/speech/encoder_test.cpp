#include "freetalk/speech/encoder.h"

#include <gtest/gtest.h>
#include <torch/torch.h>

#include "freetalk/core/options.h"
#include "freetalk/speech/features.h"

namespace freetalk::speech {
namespace {

/// Seven standard convolutions, narrow.
SpeechEncoderOptions small_options() {
  SpeechEncoderOptions options;
  options.conv_dim = std::vector<int64_t>(7, 16);
  options.hidden_size = 32;
  options.num_hidden_layers = 2;
  options.num_attention_heads = 4;
  options.intermediate_size = 64;
  options.num_conv_pos_embeddings = 16;
  options.num_conv_pos_embedding_groups = 4;
  return options;
}

/// An encoder in evaluation mode.
SpeechEncoder make_encoder(const SpeechEncoderOptions& options) {
  torch::manual_seed(1);
  SpeechEncoder encoder(options);
  encoder->eval();
  return encoder;
}

/// Largest difference between clips encoded in one padded batch and alone, relative to the output's
/// scale.
double padding_error(SpeechEncoder& encoder) {
  const torch::NoGradGuard no_grad;
  const std::vector<int64_t> lengths = {16000, 11111, 400};
  auto wave = at::zeros({3, 16000});
  auto mask = at::zeros({3, 16000}, at::kBool);
  for (size_t i = 0; i < lengths.size(); ++i) {
    wave[i].narrow(0, 0, lengths[i]).copy_(normalize_wave(at::randn({lengths[i]})));
    mask[i].narrow(0, 0, lengths[i]).fill_(true);
  }
  const auto together = encoder->forward(wave, mask);
  double error = 0.0;
  for (size_t i = 0; i < lengths.size(); ++i) {
    const auto alone = encoder->forward(wave[i].narrow(0, 0, lengths[i]).unsqueeze(0)).squeeze(0);
    const auto difference = (together[i].narrow(0, 0, alone.size(0)) - alone).abs().max();
    error = std::max(error, (difference / alone.abs().max()).item<double>());
  }
  return error;
}

TEST(SpeechEncoder, FrameCountFollowsTheConvolutions) {
  auto encoder = make_encoder(small_options());
  const torch::NoGradGuard no_grad;
  EXPECT_EQ(encoder->receptive_field(), 400);
  EXPECT_EQ(encoder->frame_stride(), 320);
  EXPECT_EQ(encoder->num_frames(399), 0);
  for (const int64_t samples : {400, 719, 720, 1039, 1040, 16000, 23456}) {
    EXPECT_EQ(encoder->num_frames(samples), (samples - 400) / 320 + 1);
    const auto output = encoder->forward(at::randn({2, samples}));
    EXPECT_EQ(output.sizes(), at::IntArrayRef({2, encoder->num_frames(samples), 32}));
  }
}

TEST(SpeechEncoder, FactoriesHaveTheirPublishedSizes) {
  const SpeechEncoder tiny(hubert_tiny());
  int64_t count = 0;
  for (const auto& parameter : tiny->parameters()) {
    count += parameter.numel();
  }
  EXPECT_GT(count, 2'000'000);
  EXPECT_LT(count, 2'600'000);
  for (const auto& options : {hubert_base(), hubert_large(), hubert_xlarge(), wav2vec2_base(),
                              wav2vec2_large(), wav2vec2_large_lv60()}) {
    EXPECT_NO_THROW(options.check());
  }
  EXPECT_EQ(hubert_large().hidden_size, 1024);
  EXPECT_EQ(hubert_xlarge().num_hidden_layers, 48);
  EXPECT_FALSE(wav2vec2_large().do_stable_layer_norm);
  EXPECT_TRUE(wav2vec2_large_lv60().do_stable_layer_norm);
}

TEST(SpeechEncoder, PaddedClipEqualsClipAloneWithLayerNorm) {
  auto options = small_options();
  options.feat_extract_norm = "layer";
  options.do_stable_layer_norm = true;
  auto encoder = make_encoder(options);
  EXPECT_LT(padding_error(encoder), 1e-5);  // float32 rounding
}

TEST(SpeechEncoder, PaddedClipEqualsClipAloneWithMaskedGroupNorm) {
  auto options = small_options();
  options.mask_group_norm = true;
  auto encoder = make_encoder(options);
  EXPECT_LT(padding_error(encoder), 1e-5);  // float32 rounding
  options.mask_group_norm = false;
  auto as_reference = make_encoder(options);
  EXPECT_GT(padding_error(as_reference), 1e-3);  // the reference lets padding into the statistics
}

/// Variants whose ways through the encoder differ.
std::vector<SpeechEncoderOptions> variants() {
  std::vector<SpeechEncoderOptions> result(5, small_options());
  result[1].feat_extract_norm = "layer";
  result[1].do_stable_layer_norm = true;
  result[1].conv_bias = true;
  result[2].conv_bias = true;  // group norm after a bias
  result[2].mask_group_norm = true;
  result[2].hidden_act = "relu";
  result[2].num_conv_pos_embeddings = 15;
  result[3].conv_dim = {24, 32, 40};  // a wide first kernel
  result[3].conv_kernel = {400, 3, 3};
  result[3].conv_stride = {80, 2, 2};
  result[3].feat_proj_layer_norm = false;
  result[3].feat_extract_activation = "silu";
  result[4].conv_dim = {8, 24, 40};
  result[4].conv_kernel = {7, 4, 3};
  result[4].conv_stride = {9, 3, 2};  // samples between the first windows
  result[4].hidden_act = "silu";
  return result;
}

/// Weights away from their initial values.
void perturb(SpeechEncoder& encoder) {
  const torch::NoGradGuard no_grad;
  for (auto& parameter : encoder->parameters()) {
    parameter.add_(0.05 * at::randn_like(parameter));
  }
}

TEST(SpeechEncoder, FastWayEqualsTheModules) {
  for (const auto& options : variants()) {
    auto encoder = make_encoder(options);
    perturb(encoder);
    auto wave = at::zeros({3, 9000});
    auto mask = at::zeros({3, 9000}, at::kLong);
    const std::vector<int64_t> lengths = {9000, 6123, 4000};
    for (int64_t row = 0; row < 3; ++row) {
      wave[row].narrow(0, 0, lengths[row]).copy_(at::randn({lengths[row]}) + 0.2);
      mask[row].narrow(0, 0, lengths[row]).fill_(1);
    }
    const auto expected = encoder->hidden_states(wave, mask);  // gradients on: the modules
    const torch::NoGradGuard no_grad;
    const auto found = encoder->hidden_states(wave, mask);
    ASSERT_EQ(found.size(), expected.size());
    for (size_t layer = 0; layer < found.size(); ++layer) {
      EXPECT_TRUE(expected[layer].requires_grad());
      for (int64_t row = 0; row < 3; ++row) {
        const int64_t frames = encoder->num_frames(lengths[row]);
        const auto ours = found[layer][row].narrow(0, 0, frames);
        const auto theirs = expected[layer][row].narrow(0, 0, frames);
        // float32 sums in another order
        EXPECT_LT(((ours - theirs).abs().max() / theirs.abs().max()).item<double>(), 2e-5)
            << core::options_to_json(options) << " layer " << layer << " row " << row;
      }
      const auto alone = encoder->forward(wave, mask, static_cast<int64_t>(layer));
      EXPECT_TRUE(alone.equal(found[layer]));
    }
  }
}

TEST(SpeechEncoder, FastWaySeesChangedWeights) {
  auto encoder = make_encoder(small_options());
  const torch::NoGradGuard no_grad;
  const auto wave = at::randn({1, 5000});
  auto before = encoder->forward(wave);
  const auto changed = [&] {
    const auto after = encoder->forward(wave);
    const bool differs = !after.equal(before);
    before = after;
    return differs;
  };
  perturb(encoder);
  EXPECT_TRUE(changed());
  for (auto& parameter : encoder->parameters()) {  // writes that autograd does not count
    parameter.set_data(parameter + 0.02 * at::randn_like(parameter));
  }
  EXPECT_TRUE(changed());
  for (auto& parameter : encoder->parameters()) {
    parameter.variable_data().mul_(1.1);
  }
  EXPECT_TRUE(changed());
  EXPECT_FALSE(changed());
}

TEST(SpeechEncoder, HalfPrecisionStaysClose) {
  auto encoder = make_encoder(small_options());
  const torch::NoGradGuard no_grad;
  const auto wave = normalize_wave(at::randn({2, 8000}));
  const auto expected = encoder->forward(wave);
  encoder->to(at::kBFloat16);
  const auto found = encoder->forward(wave.to(at::kBFloat16));
  EXPECT_EQ(found.scalar_type(), at::kBFloat16);
  // 8 bits of each weight, and of each product's result, over two layers
  EXPECT_LT(((found - expected).norm() / expected.norm()).item<double>(), 0.02);
}

TEST(SpeechEncoder, RefusesLayersThatAreNotThere) {
  auto encoder = make_encoder(small_options());
  const auto wave = at::randn({1, 3000});
  EXPECT_THROW(encoder->forward(wave, std::nullopt, 3), std::invalid_argument);
  EXPECT_THROW(encoder->forward(wave, std::nullopt, -2), std::invalid_argument);
  EXPECT_EQ(encoder->hidden_states(wave).size(), 3U);
}

TEST(SpeechEncoder, FullMaskEqualsNoMask) {
  auto encoder = make_encoder(small_options());
  const torch::NoGradGuard no_grad;
  const auto wave = at::randn({2, 5000});
  const auto mask = at::ones({2, 5000}, at::kLong);
  EXPECT_TRUE(encoder->forward(wave, mask).equal(encoder->forward(wave)));
}

TEST(SpeechEncoder, HalvesMakeTheWhole) {
  auto encoder = make_encoder(small_options());
  const torch::NoGradGuard no_grad;
  const auto wave = at::randn({1, 5000});
  const auto features = encoder->extract_features(wave);
  EXPECT_TRUE(encoder->encode_features(features).equal(encoder->forward(wave)));
}

TEST(SpeechEncoder, DropoutActsInTrainingOnly) {
  auto encoder = make_encoder(small_options());
  const torch::NoGradGuard no_grad;
  const auto wave = at::randn({1, 3000});
  EXPECT_TRUE(encoder->forward(wave).equal(encoder->forward(wave)));
  encoder->train();
  EXPECT_FALSE(encoder->forward(wave).equal(encoder->forward(wave)));
}

TEST(SpeechEncoder, LayerDropSkipsLayers) {
  auto options = small_options();
  options.hidden_dropout = options.attention_dropout = options.activation_dropout = 0.0;
  options.layerdrop = 0.5;
  auto encoder = make_encoder(options);
  encoder->train();
  const torch::NoGradGuard no_grad;
  const auto wave = at::randn({1, 3000});
  const auto first = encoder->forward(wave);
  bool differs = false;
  for (int i = 0; i < 20; ++i) {
    differs = differs || !encoder->forward(wave).equal(first);
  }
  EXPECT_TRUE(differs);
}

TEST(SpeechEncoder, RefusesBadArguments) {
  auto encoder = make_encoder(small_options());
  EXPECT_THROW(encoder->forward(at::randn({16000})), std::invalid_argument);
  EXPECT_THROW(encoder->forward(at::randn({1, 399})), std::invalid_argument);
  EXPECT_THROW(encoder->forward(at::ones({1, 1000}, at::kLong)), std::invalid_argument);
  const auto wave = at::randn({2, 1000});
  EXPECT_THROW(encoder->forward(wave, at::ones({2, 999})), std::invalid_argument);
  auto gap = at::ones({2, 1000}, at::kBool);
  gap[0][500] = false;
  EXPECT_THROW(encoder->forward(wave, gap), std::invalid_argument);
  auto short_clip = at::ones({2, 1000}, at::kBool);
  short_clip[1].narrow(0, 399, 601).fill_(false);
  EXPECT_THROW(encoder->forward(wave, short_clip), std::invalid_argument);
  EXPECT_THROW(encoder->encode_features(at::randn({1, 5, 3})), std::invalid_argument);
}

TEST(SpeechEncoderOptions, CheckNamesTheOption) {
  const auto message = [](const SpeechEncoderOptions& options) -> std::string {
    try {
      options.check();
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "";
  };
  auto options = small_options();
  options.num_attention_heads = 5;
  EXPECT_NE(message(options).find("num_attention_heads"), std::string::npos);
  options = small_options();
  options.conv_stride.pop_back();
  EXPECT_NE(message(options).find("conv_stride"), std::string::npos);
  options = small_options();
  options.feat_extract_norm = "batch";
  EXPECT_NE(message(options).find("feat_extract_norm"), std::string::npos);
  options = small_options();
  options.hidden_dropout = 1.0;
  EXPECT_NE(message(options).find("hidden_dropout"), std::string::npos);
}

}  // namespace
}  // namespace freetalk::speech
