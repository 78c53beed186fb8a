#include "window_group.h"

#include <ATen/ATen.h>

#include <algorithm>

namespace freetalk::ats {
namespace {

/// Weights of one window's frames: ramps over the overlaps with its neighbours, so that all
/// windows' sum to one after division by their total.
at::Tensor fade_weights(int64_t frames, int64_t overlap) {
  const at::Tensor index = at::arange(frames, at::kFloat);
  const at::Tensor edge = at::minimum(index, static_cast<double>(frames - 1) - index);
  return ((edge + 1) / static_cast<double>(overlap + 1)).clamp_max(1.0);
}

at::Tensor stack_windows(const at::Tensor& x, const std::vector<int64_t>& starts, int64_t window,
                         int64_t frame_dim) {
  std::vector<at::Tensor> windows;
  for (const int64_t start : starts) windows.push_back(x.narrow(frame_dim, start, window));
  return at::stack(windows, frame_dim);
}

constexpr int64_t kBrows = 17, kNose = 27, kEyes = 36, kMouth = 48;  // first landmarks (iBUG)

}  // namespace

at::Tensor noise_amount(const GenerateOptions& options, const at::Tensor& like) {
  at::Tensor amount = at::full({kNumLandmarks, 3}, options.mouth_temperature, like.options());
  amount.narrow(0, kBrows, kNose - kBrows).fill_(1.0);
  amount.narrow(0, kEyes, kMouth - kEyes).fill_(1.0);
  return amount.flatten();
}

int64_t WindowPlan::shared_frames(size_t group) const {
  if (group + 1 >= groups.size()) return 0;
  return groups[group].back() + window - groups[group + 1].front();
}

WindowPlan plan_windows(int64_t num_frames, int64_t max_frames, const GenerateOptions& options) {
  WindowPlan plan;
  plan.window = std::min(num_frames, max_frames);
  const auto starts =
      window_starts(num_frames, plan.window, std::min(options.window_overlap, plan.window - 1));
  const auto size = static_cast<size_t>(options.windows_per_batch);
  for (size_t first = 0; first < starts.size(); first += size) {
    const size_t last = std::min(first + size, starts.size());
    plan.groups.emplace_back(starts.begin() + static_cast<std::ptrdiff_t>(first),
                             starts.begin() + static_cast<std::ptrdiff_t>(last));
  }
  return plan;
}

WindowGroup::WindowGroup(AtsInference& network, const WindowPlan& plan, std::vector<int64_t> starts,
                         const at::Tensor& audio, const Affect& affect,
                         const GenerateOptions& options, Shared before, int64_t shared_after,
                         int64_t known)
    : network_(network),
      options_(options),
      starts_(std::move(starts)),
      window_(plan.window),
      prepared_(network.prepare(stack_windows(audio, starts_, window_, 0), affect,
                                /*null_audio=*/options.audio_guidance != 1, known)),
      before_(std::move(before)) {
  const bool single = plan.groups.size() == 1 && starts_.size() == 1;
  fade_ = (single ? at::ones({window_}) : fade_weights(window_, options.window_overlap))
              .to(audio.options())
              .unsqueeze(1);
  total_ = at::zeros({starts_.back() + window_, 1}, audio.options());
  for (const int64_t start : starts_) total_.narrow(0, start, window_).add_(fade_);
  if (before_.num_frames > 0) total_.narrow(0, 0, before_.num_frames).add_(before_.weight);
  after_.num_frames = shared_after;
  after_.weight = total_.narrow(0, total_.size(0) - shared_after, shared_after);

  const double audio_extra = options.audio_guidance - 1, affect_extra = options.affect_guidance - 1;
  const int64_t num_emotions = affect.emotion.size(0);
  for (int64_t k = 0; k < num_emotions; ++k) {
    at::Tensor weight = at::ones({1, 1, 1}, audio.options());
    if (affect.weight.defined()) {
      weight = stack_windows(affect.weight.narrow(1, k, 1), starts_, window_, 0);
      if (weight.eq(0).all().item<bool>()) continue;
    }
    variants_.push_back({false, k});
    variant_weights_.push_back(weight * (1 + audio_extra + affect_extra));
    if (audio_extra == 0) continue;
    variants_.push_back({true, k});
    variant_weights_.push_back(weight * -audio_extra);
  }
  if (affect_extra != 0) {
    variants_.push_back({false, num_emotions});
    variant_weights_.push_back(at::full({1, 1, 1}, -affect_extra, audio.options()));
  }
}

at::Tensor WindowGroup::guided(const at::Tensor& windows, int64_t timestep) const {
  const int64_t samples = windows.size(0), num_windows = windows.size(1);
  const int64_t slots = samples * static_cast<int64_t>(variants_.size());
  const int64_t at_once = std::max<int64_t>(1, options_.windows_per_batch / num_windows);
  at::Tensor result = at::zeros_like(windows);
  for (int64_t first = 0; first < slots; first += at_once) {
    std::vector<at::Tensor> inputs;
    std::vector<AtsInference::Variant> variants;
    for (int64_t slot = first; slot < std::min(first + at_once, slots); ++slot) {
      inputs.push_back(windows[slot % samples]);
      variants.push_back(variants_[static_cast<size_t>(slot / samples)]);
    }
    const at::Tensor x0 = network_.denoise(at::stack(inputs), timestep, prepared_, variants);
    for (int64_t i = 0; i < x0.size(0); ++i) {
      const int64_t slot = first + i;
      result[slot % samples].add_(x0[i] * variant_weights_[static_cast<size_t>(slot / samples)]);
    }
  }
  return result;
}

at::Tensor WindowGroup::denoise(const at::Tensor& x, int64_t timestep) {
  const at::Tensor x0 = guided(stack_windows(x, starts_, window_, 1), timestep);
  at::Tensor sum = at::zeros_like(x);
  for (size_t i = 0; i < starts_.size(); ++i) {
    sum.narrow(1, starts_[i], window_).add_(x0.select(1, static_cast<int64_t>(i)) * fade_);
  }
  if (before_.num_frames > 0) sum.narrow(1, 0, before_.num_frames).add_(before_.x0[step_]);
  if (after_.num_frames > 0) {
    after_.x0.push_back(sum.narrow(1, sum.size(1) - after_.num_frames, after_.num_frames).clone());
  }
  ++step_;
  return sum.div_(total_);
}

at::Tensor WindowGroup::draw(const at::Tensor& like, std::vector<at::Generator>& generators) {
  std::vector<at::Tensor> drawn;
  for (const at::Generator& generator : generators) {
    drawn.push_back(at::randn({like.size(1), like.size(2)}, generator, like.options()));
  }
  at::Tensor noise = at::stack(drawn);
  if (before_.num_frames > 0) noise.narrow(1, 0, before_.num_frames).copy_(before_.noise[draw_]);
  if (after_.num_frames > 0) {
    after_.noise.push_back(
        noise.narrow(1, noise.size(1) - after_.num_frames, after_.num_frames).clone());
  }
  ++draw_;
  return noise;
}

}  // namespace freetalk::ats
