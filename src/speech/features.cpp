#include "freetalk/speech/features.h"

#include <torch/torch.h>

#include <algorithm>
#include <cmath>

#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "freetalk/core/torch_error.h"
#include "pieces.h"

namespace freetalk::speech {
namespace {

/// interpolate_frames() of a padded batch: features (B, S', C), positions (T,), valid (B,).
at::Tensor interpolate_batch(const at::Tensor& features, const at::Tensor& positions,
                             const at::Tensor& valid) {
  const auto last = (valid.to(features.device()) - 1).clamp_min(0).unsqueeze(1);         // (B, 1)
  const auto place = at::minimum(positions.to(features.device()).clamp_min(0.0), last);  // (B, T)
  const auto lower = place.floor();
  const auto weight = (place - lower).to(features.options()).unsqueeze(2);
  const auto take = [&](const at::Tensor& index) {  // (B, T) -> (B, T, C)
    return features.gather(1, index.unsqueeze(2).expand({-1, -1, features.size(2)}));
  };
  const auto left = take(lower.to(at::kLong));
  const auto right = take(at::minimum(lower.to(at::kLong) + 1, last));
  return left + weight * (right - left);
}

void check_features(const at::Tensor& features, int64_t num_frames) {
  FREETALK_CHECK((features.dim() == 2 || features.dim() == 3) && features.size(-2) > 0,
                 "features have shape ", features.sizes(),
                 ": expected (B, S', C) or (S', C) with at least one frame");
  FREETALK_CHECK(features.is_floating_point(), "features are of type ", features.scalar_type(),
                 ": expected floating point");
  FREETALK_CHECK(num_frames > 0, "num_frames is ", num_frames, ": it must be positive");
}

void check_fps(double fps) {
  FREETALK_CHECK(std::isfinite(fps) && fps > 0.0, "fps is ", fps, ": it must be positive");
}

}  // namespace

at::Tensor normalize_wave(const at::Tensor& wave, const std::optional<at::Tensor>& mask) {
  FREETALK_CHECK((wave.dim() == 1 || wave.dim() == 2) && wave.size(-1) > 0, "wave has shape ",
                 wave.sizes(), ": expected (S,) or (B, S) with at least one sample");
  FREETALK_CHECK(wave.is_floating_point(), "wave is of type ", wave.scalar_type(),
                 ": expected floating point samples");
  constexpr double kEpsilon = 1e-7;
  if (!mask) {
    const auto centred = wave - wave.mean(-1, true);
    return centred / (centred.square().mean(-1, true) + kEpsilon).sqrt();
  }
  FREETALK_CHECK(mask->sizes() == wave.sizes(), "mask has shape ", mask->sizes(), ", wave ",
                 wave.sizes(), ": they must agree");
  const auto real = (*mask != 0).to(wave.options());
  const auto count = real.sum(-1, true).clamp_min(1.0);
  const auto centred = (wave - (wave * real).sum(-1, true) / count) * real;
  return centred / (centred.square().sum(-1, true) / count + kEpsilon).sqrt();
}

at::Tensor resample_features(const at::Tensor& features, int64_t num_frames, double fps,
                             FrameTiming timing, const std::optional<at::Tensor>& valid_frames) {
  check_features(features, num_frames);
  check_fps(fps);
  const auto seconds = at::arange(num_frames, at::kDouble) / fps;
  const auto positions = (seconds - timing.offset_s) * timing.rate_hz;
  if (!valid_frames) {
    return interpolate_frames(features, positions);
  }
  FREETALK_CHECK(features.dim() == 3 && valid_frames->sizes() == at::IntArrayRef(features.size(0)),
                 "valid_frames have shape ", valid_frames->sizes(), ", features ", features.sizes(),
                 ": expected (B,) and (B, S', C)");
  return interpolate_batch(features, positions, *valid_frames);
}

at::Tensor resample_features(const at::Tensor& features, int64_t num_frames) {
  check_features(features, num_frames);
  const FrameTiming timing;
  // S' frames come from S' * 320 + 80 ... S' * 320 + 399 samples.
  const double duration_s =
      (static_cast<double>(features.size(-2)) * 320.0 + 240.0) / static_cast<double>(kSampleRateHz);
  return resample_features(features, num_frames, static_cast<double>(num_frames) / duration_s,
                           timing);
}

void EncodeOptions::check() const {
  FREETALK_CHECK(std::isfinite(context_s) && context_s >= 0.1, "context_s is ", context_s,
                 ": it must be at least 0.1");
  FREETALK_CHECK(std::isfinite(window_s) && window_s > 0.0, "window_s is ", window_s,
                 ": it must be positive");
  FREETALK_CHECK(std::isfinite(lookahead_s) && lookahead_s >= 0.0, "lookahead_s is ", lookahead_s,
                 ": it must not be negative");
  FREETALK_CHECK(std::isfinite(fade_s) && fade_s >= 0.0, "fade_s is ", fade_s,
                 ": it must not be negative");
  FREETALK_CHECK(layer >= -1, "layer is ", layer, ": it must be -1 (the last) or a layer's number");
  FREETALK_CHECK(resample == "output" || resample == "conv", "resample is '", resample,
                 "': use output or conv");
  FREETALK_CHECK(precision == "float32" || precision == "bfloat16", "precision is '", precision,
                 "': use float32 or bfloat16");
}

int64_t num_motion_frames(int64_t num_samples, double fps) {
  check_fps(fps);
  return core::num_frames(static_cast<double>(num_samples) / static_cast<double>(kSampleRateHz),
                          fps);
}

at::Tensor encode_speech(SpeechEncoder& encoder, const at::Tensor& samples,
                         std::optional<double> fps, const EncodeOptions& options,
                         const std::function<void(double)>& progress,
                         const std::optional<at::Tensor>& layer_weights) {
  FREETALK_CHECK(samples.dim() == 1 && samples.size(0) > 0, "samples have shape ", samples.sizes(),
                 ": expected (S,) with at least one sample");
  return core::with_plain_errors("encode_speech", [&] {
    const torch::NoGradGuard no_grad;
    PieceEncoder pieces(encoder, fps, options, layer_weights);
    const int64_t num_frames = pieces.num_frames(samples.size(0));
    if (!options.streamable) {
      pieces.set_clip(samples);
    }
    auto result = at::empty({num_frames, encoder->options().hidden_size}, pieces.result_options());
    int64_t filled = 0;
    const auto append = [&](const at::Tensor& frames) {
      result.narrow(0, filled, frames.size(0)).copy_(frames);
      filled += frames.size(0);
    };
    for (int64_t first = 0; first < samples.size(0); first += pieces.hop()) {
      const int64_t count = std::min(pieces.hop(), samples.size(0) - first);
      append(pieces.push(samples.narrow(0, first, count)));
      if (progress && first + count < samples.size(0)) {
        progress(static_cast<double>(first + count) / static_cast<double>(samples.size(0)));
      }
    }
    append(pieces.finish());
    if (progress) {
      progress(1.0);
    }
    return result;
  });
}

at::Tensor motion_features(SpeechEncoder& encoder, const at::Tensor& wave,
                           const std::optional<at::Tensor>& mask, int64_t num_frames, double fps,
                           const EncodeOptions& options,
                           const std::optional<at::Tensor>& layer_weights) {
  options.check();
  check_fps(fps);
  FREETALK_CHECK(num_frames > 0, "num_frames is ", num_frames, ": it must be positive");
  return core::with_plain_errors("motion_features", [&] {
    const auto layers = [&](const at::Tensor& features, const std::optional<at::Tensor>& valid) {
      return layer_weights ? mix_states(encoder->encode_states(features, valid), *layer_weights)
                           : encoder->encode_features(features, valid, options.layer);
    };
    const auto features = encoder->extract_features(wave, mask);
    std::optional<at::Tensor> valid, motion;
    if (mask) {
      const auto samples = (*mask != 0).sum(1);
      valid = encoder->count_frames(samples);
      motion = (samples * (fps / static_cast<double>(kSampleRateHz)))
                   .round()
                   .clamp(1.0, static_cast<double>(num_frames))
                   .to(at::kLong);
    }
    if (options.resample == "conv") {
      return layers(resample_features(features, num_frames, fps, encoder->timing(), valid), motion);
    }
    return resample_features(layers(features, valid), num_frames, fps, encoder->timing(), valid);
  });
}

}  // namespace freetalk::speech
