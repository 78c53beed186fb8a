#include "freetalk/speech/features.h"

#include <torch/torch.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "freetalk/core/error.h"

namespace freetalk::speech {
namespace {

/// Values of `features` (..., S', C) at fractional frame positions (T,) double.
at::Tensor interpolate(const at::Tensor& features, at::Tensor positions) {
  const int64_t last = features.size(-2) - 1;
  positions = positions.clamp(0.0, static_cast<double>(last));
  const auto lower = positions.floor();
  const auto weight = (positions - lower).to(features.options()).unsqueeze(1);  // (T, 1)
  const auto index = lower.to(at::kLong);
  const auto left = features.index_select(-2, index.to(features.device()));
  const auto right = features.index_select(-2, (index + 1).clamp_max(last).to(features.device()));
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

/// Evaluation mode for a scope, then every submodule as it was.
class EvaluationScope {
 public:
  explicit EvaluationScope(torch::nn::Module& module) : module_(module) {
    for (const auto& part : module_.modules(/*include_self=*/false)) {
      was_training_.push_back(part->is_training());
    }
    self_was_training_ = module_.is_training();
    module_.eval();
  }
  ~EvaluationScope() {
    module_.train(self_was_training_);
    size_t index = 0;
    for (const auto& part : module_.modules(/*include_self=*/false)) {  // parents come first
      part->train(was_training_[index++]);
    }
  }
  EvaluationScope(const EvaluationScope&) = delete;
  EvaluationScope& operator=(const EvaluationScope&) = delete;

 private:
  torch::nn::Module& module_;
  bool self_was_training_ = false;
  std::vector<bool> was_training_;
};

/// One piece of a long clip, in samples, with the cross-fades that join it to its neighbours.
struct Window {
  int64_t start = 0;
  int64_t size = 0;
  double fade_in = -1e9;   // centre of the cross-fade with the window before, in samples
  double fade_out = 1e18;  // centre of the cross-fade with the window after
};

/// Equal windows that cover `num_samples`, starts on the frame grid, overlaps of at least 2
/// `context`.
std::vector<Window> plan_windows(int64_t num_samples, int64_t size, int64_t context,
                                 int64_t stride) {
  if (num_samples <= size) {
    return {{0, num_samples}};
  }
  const int64_t hop = size - 2 * context - stride;  // a stride less: starts are rounded to the grid
  const int64_t span = num_samples - size;
  const int64_t count = (span + hop - 1) / hop + 1;
  std::vector<Window> windows;
  for (int64_t k = 0; k < count; ++k) {
    const int64_t start = span * k / (count - 1) / stride * stride;
    windows.push_back({start, k + 1 < count ? size : num_samples - start});
  }
  for (size_t k = 0; k + 1 < windows.size(); ++k) {
    const double centre =
        0.5 * static_cast<double>(windows[k + 1].start + windows[k].start + windows[k].size);
    windows[k].fade_out = windows[k + 1].fade_in = centre;
  }
  return windows;
}

/// Adds the features of one window to the motion frames that it reaches.
void add_window(const at::Tensor& features, const Window& window, double fps, double fade,
                FrameTiming timing, at::Tensor& result) {
  const double rate = static_cast<double>(kSampleRateHz);
  const double first_s = (window.fade_in - 0.5 * fade) / rate;
  const double last_s = (window.fade_out + 0.5 * fade) / rate;
  const double last_frame = static_cast<double>(result.size(0) - 1);
  const auto begin = static_cast<int64_t>(std::clamp(std::ceil(first_s * fps), 0.0, last_frame));
  const auto end = static_cast<int64_t>(std::clamp(std::floor(last_s * fps), 0.0, last_frame)) + 1;
  const auto seconds = at::arange(begin, end, at::kDouble) / fps;
  const double start_s = static_cast<double>(window.start) / rate;
  const auto values = interpolate(features, (seconds - start_s - timing.offset_s) * timing.rate_hz);
  const auto rise = ((seconds * rate - window.fade_in) / fade + 0.5).clamp(0.0, 1.0);
  const auto fall = ((window.fade_out - seconds * rate) / fade + 0.5).clamp(0.0, 1.0);
  const auto weight = (rise + fall - 1.0).to(values.options()).unsqueeze(1);
  result.narrow(0, begin, end - begin).add_(values * weight);
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
                             FrameTiming timing) {
  check_features(features, num_frames);
  check_fps(fps);
  const auto seconds = at::arange(num_frames, at::kDouble) / fps;
  return interpolate(features, (seconds - timing.offset_s) * timing.rate_hz);
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
  FREETALK_CHECK(std::isfinite(window_s) && std::isfinite(context_s) && context_s >= 0.1 &&
                     window_s >= 2.5 * context_s,
                 "window_s is ", window_s, " and context_s ", context_s,
                 ": context_s must be at least 0.1 and window_s at least 2.5 times as long");
}

int64_t num_motion_frames(int64_t num_samples, double fps) {
  check_fps(fps);
  const double frames = static_cast<double>(num_samples) / static_cast<double>(kSampleRateHz) * fps;
  return std::max<int64_t>(1, std::llround(frames));
}

at::Tensor encode_speech(SpeechEncoder& encoder, const at::Tensor& samples, double fps,
                         const EncodeOptions& options,
                         const std::function<void(double)>& progress) {
  FREETALK_CHECK(samples.dim() == 1 && samples.size(0) > 0, "samples have shape ", samples.sizes(),
                 ": expected (S,) with at least one sample");
  options.check();
  const int64_t num_frames = num_motion_frames(samples.size(0), fps);
  const torch::NoGradGuard no_grad;
  const EvaluationScope evaluation(*encoder);
  const auto target = encoder->parameters().front().options().requires_grad(false);
  const double rate = static_cast<double>(kSampleRateHz);
  const double context = options.context_s * rate;

  auto wave = normalize_wave(samples);
  const int64_t missing = encoder->receptive_field() - wave.size(0);
  if (missing > 0) {
    wave = at::constant_pad_nd(wave, {0, missing});
  }
  const auto windows = plan_windows(wave.size(0), std::llround(options.window_s * rate),
                                    std::llround(context), encoder->frame_stride());
  auto result = at::zeros({num_frames, encoder->options().hidden_size}, target);
  for (size_t k = 0; k < windows.size(); ++k) {
    const auto piece = wave.narrow(0, windows[k].start, windows[k].size).to(target).unsqueeze(0);
    const auto features = encoder->forward(piece).squeeze(0);  // (S', C)
    add_window(features, windows[k], fps, context, encoder->timing(), result);
    if (progress) {
      progress(static_cast<double>(k + 1) / static_cast<double>(windows.size()));
    }
  }
  return result;
}

}  // namespace freetalk::speech
