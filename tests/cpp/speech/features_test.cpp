#include "freetalk/speech/features.h"

#include <gtest/gtest.h>
#include <torch/torch.h>

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
  options.context_s = 12.0;
  EXPECT_THROW(encode_speech(encoder, at::randn({800}), 30.0, options), std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::speech
