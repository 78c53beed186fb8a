#include "freetalk/speech/features.h"

#include <gtest/gtest.h>
#include <torch/torch.h>

#include <algorithm>

#include "freetalk/speech/stream.h"

namespace freetalk::speech {
namespace {

/// Without transformer layers a frame sees 0.2 s around it, so that windows with context lose
/// nothing.
SpeechEncoderOptions local_options() {
  SpeechEncoderOptions options;
  options.feat_extract_norm = "layer";
  options.conv_dim = std::vector<int64_t>(7, 8);
  options.hidden_size = 16;
  options.num_hidden_layers = 0;
  options.num_attention_heads = 2;
  options.num_conv_pos_embeddings = 8;
  options.num_conv_pos_embedding_groups = 4;
  return options;
}

double relative_error(const at::Tensor& found, const at::Tensor& expected) {
  return ((found - expected).abs().max() / expected.abs().max()).item<double>();
}

TEST(NormalizeWave, GivesZeroMeanAndUnitVariance) {
  const auto wave = 3.0 + 0.2 * at::randn({2, 5000}, at::kDouble);
  const auto result = normalize_wave(wave);
  EXPECT_LT(result.mean(-1).abs().max().item<double>(), 1e-12);
  // the epsilon of 1e-7 against a variance of 0.04
  EXPECT_LT((result.var(-1, false) - 1.0).abs().max().item<double>(), 1e-5);
  EXPECT_TRUE(result[1].allclose(normalize_wave(wave[1])));
}

TEST(NormalizeWave, LeavesPaddingOut) {
  const auto wave = at::randn({1, 1000}) + 1.0;
  auto mask = at::zeros({1, 1000}, at::kBool);
  mask.narrow(1, 0, 700).fill_(true);
  const auto result = normalize_wave(wave, mask);
  EXPECT_TRUE(
      result.narrow(1, 0, 700).allclose(normalize_wave(wave.narrow(1, 0, 700)), 1e-4, 1e-5));
  EXPECT_EQ(result.narrow(1, 700, 300).abs().max().item<float>(), 0.0F);
}

TEST(NormalizeWave, KeepsSilenceSilent) {
  EXPECT_EQ(normalize_wave(at::full({800}, 0.25)).abs().max().item<float>(), 0.0F);
}

TEST(ResampleFeatures, ReproducesALinearFunctionOfTime) {
  const auto frames = at::arange(50, at::kDouble);
  const auto features = (frames * 0.02 + 0.0125).view({1, 50, 1});  // each frame holds its own time
  for (const double fps : {24.0, 25.0, 29.97, 30.0, 60.0, 120.0}) {
    const auto count = static_cast<int64_t>(fps);
    const auto result = resample_features(features, count, fps).view({-1});
    const auto expected = (at::arange(count, at::kDouble) / fps).clamp(0.0125, 49 * 0.02 + 0.0125);
    EXPECT_LT((result - expected).abs().max().item<double>(), 1e-12) << fps;
  }
}

TEST(ResampleFeatures, HoldsTheEnds) {
  const auto features = at::randn({3, 4});
  const auto result = resample_features(features, 30, 30.0);
  EXPECT_TRUE(result[0].equal(features[0]));
  EXPECT_TRUE(result[29].equal(features[2]));
}

TEST(ResampleFeatures, WithoutFpsTimesAreOffByAtMostTenMilliseconds) {
  const SpeechEncoder encoder(local_options());
  for (const int64_t samples : {8000, 8100, 8319, 16000, 31999}) {
    const int64_t count = encoder->num_frames(samples);
    const auto times = (at::arange(count, at::kDouble) * 0.02 + 0.0125).view({1, count, 1});
    const double duration = static_cast<double>(samples) / 16000.0;
    const double fps = 24.0 / duration;
    const auto exact = resample_features(times, 24, fps);
    const auto guessed = resample_features(times, 24);
    EXPECT_LE((exact - guessed).abs().max().item<double>(), 0.0101);
  }
}

TEST(ResampleFeatures, IsDifferentiable) {
  const auto features = at::randn({1, 10, 2}, at::kDouble).requires_grad_(true);
  resample_features(features, 6, 30.0).sum().backward();
  EXPECT_NEAR(features.grad().sum().item<double>(), 12.0, 1e-12);  // weights of a frame sum to one
}

TEST(ResampleFeatures, RefusesBadArguments) {
  const auto features = at::randn({1, 10, 2});
  EXPECT_THROW(resample_features(features, 0, 30.0), std::invalid_argument);
  EXPECT_THROW(resample_features(features, 5, 0.0), std::invalid_argument);
  EXPECT_THROW(resample_features(features, 5, std::nan("")), std::invalid_argument);
  EXPECT_THROW(resample_features(at::randn({10}), 5, 30.0), std::invalid_argument);
}

TEST(EncodeSpeech, GivesOneFeaturePerMotionFrame) {
  SpeechEncoder encoder(local_options());
  for (const int64_t samples : {1, 399, 400, 16000, 20001}) {
    for (const double fps : {24.0, 30.0, 59.94}) {
      const auto features = encode_speech(encoder, at::randn({samples}), fps);
      EXPECT_EQ(features.size(0), num_motion_frames(samples, fps));
      EXPECT_TRUE(features.isfinite().all().item<bool>());
    }
  }
  EXPECT_EQ(num_motion_frames(16000, 30.0), 30);
  EXPECT_EQ(num_motion_frames(1, 30.0), 1);
}

TEST(EncodeSpeech, FailuresOfLibTorchAreRuntimeErrors) {
  SpeechEncoder encoder(local_options());
  const auto nowhere = at::zeros({16000}, at::TensorOptions().device(at::kMeta));
  EXPECT_THROW(encode_speech(encoder, nowhere, 30.0), std::runtime_error);
}

TEST(EncodeSpeech, WindowsEqualTheWholeWhenContextSuffices) {
  SpeechEncoder encoder(local_options());
  EncodeOptions whole;
  whole.window_s = 60.0;
  EncodeOptions windows;
  windows.window_s = 3.0;
  windows.context_s = 0.8;
  for (const int64_t samples : {48001, 51200, 100003, 333333}) {
    const auto wave = at::randn({samples}) * 0.1 + 0.01;
    const auto expected = encode_speech(encoder, wave, 30.0, whole);
    const auto found = encode_speech(encoder, wave, 30.0, windows);
    EXPECT_LT(relative_error(found, expected), 1e-5) << samples;  // float32 rounding
  }
}

TEST(EncodeSpeech, GroupNormOfPiecesIsThatOfTheWhole) {
  auto options = local_options();
  options.feat_extract_norm = "group";
  SpeechEncoder encoder(options);
  encoder->eval();
  EncodeOptions whole;
  whole.window_s = 60.0;
  EncodeOptions pieces;
  pieces.window_s = 3.0;
  pieces.context_s = 0.8;
  // loud at first, then faint: statistics of a piece alone would differ
  const auto wave = at::randn({160000}) * at::linspace(0.5, 0.01, 160000) + 0.02;
  const auto expected = encode_speech(encoder, wave, 30.0, whole);
  EXPECT_LT(relative_error(encode_speech(encoder, wave, 30.0, pieces), expected), 1e-4);
  const auto in_one_pass = resample_features(encoder->forward(normalize_wave(wave).unsqueeze(0)),
                                             expected.size(0), 30.0);
  EXPECT_LT(relative_error(expected, in_one_pass.squeeze(0)), 1e-4);
}

TEST(EncodeSpeech, ConvFeaturesTakeTheMotionsRate) {
  SpeechEncoder encoder(local_options());
  encoder->eval();
  const auto wave = at::randn({160000}) * 0.1;
  EncodeOptions options;
  options.resample = "conv";
  options.window_s = 60.0;
  const auto found = encode_speech(encoder, wave, 30.0, options);
  const torch::NoGradGuard no_grad;
  const auto conv = encoder->extract_features(normalize_wave(wave).unsqueeze(0));
  const auto expected = encoder->encode_features(resample_features(conv, 300, 30.0)).squeeze(0);
  EXPECT_LT(relative_error(found, expected), 1e-5);  // float32 rounding
  options.window_s = 3.0;
  options.context_s = 0.8;
  EXPECT_LT(relative_error(encode_speech(encoder, wave, 30.0, options), expected), 1e-4);
}

TEST(EncodeSpeech, LayerWeightsSumHiddenStates) {
  auto options = local_options();
  options.num_hidden_layers = 2;
  options.hidden_dropout = options.attention_dropout = options.activation_dropout = 0.0;
  SpeechEncoder encoder(options);
  encoder->eval();
  const auto wave = at::randn({16000}) * 0.1;
  const auto weights = at::tensor({0.5F, 0.0F, 2.0F});
  EncodeOptions first, last;
  first.layer = 0;
  const auto expected = 0.5 * encode_speech(encoder, wave, 30.0, first) +
                        2.0 * encode_speech(encoder, wave, 30.0, last);
  const auto found = encode_speech(encoder, wave, 30.0, {}, {}, weights);
  EXPECT_LT(relative_error(found, expected), 1e-5);
  EXPECT_THROW(encode_speech(encoder, wave, 30.0, {}, {}, at::ones({2})), std::invalid_argument);
}

TEST(MotionFeatures, PaddedClipEqualsClipAlone) {
  auto options = local_options();
  options.num_hidden_layers = 1;
  options.hidden_dropout = options.attention_dropout = options.activation_dropout = 0.0;
  SpeechEncoder encoder(options);
  const auto wave = at::randn({2, 16000});
  auto mask = at::ones({2, 16000}, at::kBool);
  mask[1].narrow(0, 10000, 6000).fill_(false);
  for (const char* place : {"output", "conv"}) {
    EncodeOptions choice;
    choice.resample = place;
    const auto together = motion_features(encoder, wave, mask, 30, 30.0, choice)[1];
    const int64_t frames = num_motion_frames(10000, 30.0);
    const auto alone = motion_features(encoder, wave.slice(0, 1, 2).slice(1, 0, 10000),
                                       std::nullopt, frames, 30.0, choice)[0];
    EXPECT_LT(relative_error(together.narrow(0, 0, frames), alone), 1e-5) << place;
    EXPECT_TRUE(together.requires_grad());
  }
}

TEST(SpeechStream, GivesTheFramesOfEncodeSpeech) {
  auto options = local_options();
  options.feat_extract_norm = "group";
  options.num_hidden_layers = 1;
  SpeechEncoder encoder(options);
  EncodeOptions pieces = stream_options();
  pieces.window_s = 1.8;
  pieces.context_s = 1.0;
  const std::optional<double> rates[] = {std::nullopt, 30.0};
  for (const int64_t count : {300, 12800, 12801, 40000}) {
    const auto wave = at::randn({count}) * at::linspace(0.1, 0.3, count);
    for (const auto& fps : rates) {
      const auto expected = encode_speech(encoder, wave, fps, pieces);
      SpeechStream stream(encoder, fps, pieces);
      for (const int64_t step : {777, 20000}) {  // finish() starts afresh
        std::vector<at::Tensor> parts;
        for (int64_t first = 0; first < count; first += step) {
          parts.push_back(stream.push(wave.slice(0, first, std::min(count, first + step))));
        }
        parts.push_back(stream.finish());
        const auto found = at::cat(parts);
        ASSERT_EQ(found.sizes(), expected.sizes()) << count;
        EXPECT_LT(relative_error(found, expected), 1e-4) << count;
      }
    }
  }
}

TEST(SpeechStream, FramesComeWithinTheLatency) {
  SpeechEncoder encoder(local_options());
  SpeechStream stream(encoder, 30.0);
  EXPECT_LT(stream.latency_s(), 0.9);
  const auto wave = at::randn({48000}) * 0.1;
  int64_t ready = 0;
  double worst = 0.0;
  for (int64_t first = 0; first < wave.size(0); first += 800) {
    ready += stream.push(wave.slice(0, first, first + 800)).size(0);
    const double heard_s = static_cast<double>(first + 800) / 16000.0;
    worst = std::max(worst, heard_s - static_cast<double>(ready) / 30.0);  // the next frame waits
  }
  EXPECT_GT(ready, 0);
  EXPECT_LE(worst, stream.latency_s() + 0.051);  // pushes are 50 ms apart
}

TEST(EncodeSpeech, ReportsProgressAndLeavesTheEncoderAsItWas) {
  SpeechEncoder encoder(local_options());
  encoder->train();
  EncodeOptions options;
  options.window_s = 2.0;
  options.context_s = 0.5;
  std::vector<double> shares;
  const auto features = encode_speech(encoder, at::randn({100000}), 25.0, options,
                                      [&](double share) { shares.push_back(share); });
  EXPECT_GT(shares.size(), 3U);
  EXPECT_TRUE(std::is_sorted(shares.begin(), shares.end()));
  EXPECT_EQ(shares.back(), 1.0);
  EXPECT_TRUE(encoder->is_training());
  EXPECT_FALSE(features.requires_grad());
}

TEST(EncodeSpeech, RefusesBadArguments) {
  SpeechEncoder encoder(local_options());
  EXPECT_THROW(encode_speech(encoder, at::randn({1, 800}), 30.0), std::invalid_argument);
  EXPECT_THROW(encode_speech(encoder, at::randn({0}), 30.0), std::invalid_argument);
  EXPECT_THROW(encode_speech(encoder, at::randn({800}), -1.0), std::invalid_argument);
  EncodeOptions options;
  options.window_s = 20.0;
  options.context_s = 12.0;  // and as much lookahead
  EXPECT_THROW(encode_speech(encoder, at::randn({800}), 30.0, options), std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::speech
