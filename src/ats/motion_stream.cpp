#include "freetalk/ats/motion_stream.h"

#include <torch/torch.h>

#include <algorithm>
#include <utility>

#include "freetalk/core/error.h"
#include "freetalk/core/random.h"
#include "freetalk/core/torch_error.h"
#include "freetalk/diffusion/sampler.h"
#include "window_group.h"

namespace freetalk::ats {
namespace {

/// randn() fills sixteen numbers at a time: blocks of four frames (816 numbers) give the noise that
/// a whole motion drawn at once has.
constexpr int64_t kNoiseBlock = 4;

/// The emotion that holds between two keys.
EmotionKey between(const EmotionKey& a, const EmotionKey& b, double time_s) {
  const double share = std::clamp((time_s - a.time_s) / (b.time_s - a.time_s), 0.0, 1.0);
  return {time_s, a.emotion * (1 - share) + b.emotion * share,
          a.intensity * (1 - share) + b.intensity * share};
}

EmotionKey at_time(const std::vector<EmotionKey>& keys, double time_s) {
  const auto after = std::find_if(keys.begin(), keys.end(),
                                  [&](const EmotionKey& key) { return key.time_s > time_s; });
  if (after == keys.begin()) return {time_s, keys.front().emotion, keys.front().intensity};
  if (after == keys.end()) return {time_s, keys.back().emotion, keys.back().intensity};
  return between(*(after - 1), *after, time_s);
}

}  // namespace

void MotionStreamOptions::check() const {
  generate.check();
  FREETALK_CHECK(generate.sampler == "dpmpp" || (generate.sampler == "ddim" && generate.eta == 0),
                 "a stream needs dpmpp, or ddim with eta 0: found ", generate.sampler, " with eta ",
                 generate.eta);
  FREETALK_CHECK(redo_frames >= 0 && window_frames >= 2 * redo_frames + 2, "window_frames (",
                 window_frames, ") must be at least twice redo_frames (", redo_frames,
                 ") and two more");
  FREETALK_CHECK(std::isfinite(emotion_ramp_s) && emotion_ramp_s > 0,
                 "emotion_ramp_s must be positive, found ", emotion_ramp_s);
}

struct MotionStream::State {
  Ats model;
  std::vector<EmotionKey> first_emotions, keys;
  uint64_t seed;
  MotionStreamOptions options;
  diffusion::Schedule schedule;
  diffusion::SamplerOptions sampling;
  AtsInference network;
  at::Generator generator;
  at::Tensor drawn;                   // noise of frames to come
  at::Tensor features, noise, known;  // of frames from `first` on; known ends at `shown`
  int64_t first = 0, heard = 0, shown = 0;

  static at::ScalarType dtype_of(const MotionStreamOptions& options) {
    return options.generate.precision == "bfloat16" ? at::kBFloat16 : at::kFloat;
  }

  State(Ats denoiser, std::vector<EmotionKey> emotions, uint64_t noise_seed,
        const MotionStreamOptions& chosen)
      : model(std::move(denoiser)),
        first_emotions(std::move(emotions)),
        seed(noise_seed),
        options(chosen),
        schedule(model->options().schedule_options()),
        sampling(chosen.generate.sampler_options()),
        network(*model, diffusion::sampler_timesteps(schedule, sampling), dtype_of(chosen),
                chosen.window_frames) {
    FREETALK_CHECK(options.window_frames <= model->options().max_frames, "window_frames (",
                   options.window_frames, ") exceeds the model's max_frames (",
                   model->options().max_frames, ")");
    reset();
  }

  at::TensorOptions floats() const {
    return at::TensorOptions(model->parameters().front().device()).dtype(at::kFloat);
  }

  void reset() {
    keys = first_emotions;
    generator = core::make_generator(seed, floats().device());
    drawn = noise = known = at::empty({0, kMotionDim}, floats());
    features = at::empty({0, model->options().audio_dim}, floats());
    first = heard = shown = 0;
  }

  void draw(int64_t count) {
    const at::Tensor amount = noise_amount(options.generate, noise);
    while (drawn.size(0) < count) {
      const auto block = at::randn({kNoiseBlock, kMotionDim}, generator, floats());
      drawn = at::cat({drawn, block * amount});
    }
    noise = at::cat({noise, drawn.narrow(0, 0, count)});
    drawn = drawn.slice(0, count).clone();
  }

  /// What the window's frames feel: those that are known no longer matter.
  Affect affect() {
    const double fps = model->options().fps;
    while (keys.size() > 1 && keys[1].time_s <= static_cast<double>(shown) / fps) {
      keys.erase(keys.begin());
    }
    if (keys.size() == 1) {
      return constant_affect(keys[0].emotion.to(floats()), keys[0].intensity);
    }
    std::vector<EmotionKey> relative = keys;
    for (EmotionKey& key : relative) key.time_s -= static_cast<double>(first) / fps;
    const Affect felt = interpolate(relative, heard - first, fps);
    return {felt.emotion.to(floats()), felt.intensity.to(floats()), felt.weight.to(floats())};
  }

  /// Denoises the window that ends with these features; shows frames up to `until` (from the end).
  at::Tensor step(const at::Tensor& next, int64_t kept_back) {
    heard += next.size(0);
    draw(next.size(0));
    features = at::cat({features, next.to(floats())});
    const int64_t leave = std::max<int64_t>(0, features.size(0) - options.window_frames);
    first += leave;
    features = features.slice(0, leave).clone();
    noise = noise.slice(0, leave).clone();
    known = known.slice(0, leave).clone();
    const int64_t frames = heard - first, done = shown - first;
    const WindowPlan plan{frames, {{0}}};
    const bool clean = model->options().known_prefix;
    WindowGroup group(network, plan, {0}, features, affect(), options.generate, {}, 0,
                      clean ? done : 0);
    const auto denoise = [&](at::Tensor x, int64_t timestep) {
      if (clean) x = at::cat({known.unsqueeze(0), x.slice(1, done)}, 1);
      at::Tensor x0 = group.denoise(x, timestep);
      x0.narrow(1, 0, done).copy_(known);
      return x0;
    };
    const auto none = [](const at::Tensor& like) { return at::zeros_like(like); };
    const at::Tensor x0 =
        diffusion::sample(schedule, denoise, noise.unsqueeze(0), sampling, none).squeeze(0);
    const int64_t fresh = std::max<int64_t>(0, frames - done - kept_back);
    const at::Tensor made = x0.narrow(0, done, fresh);
    known = at::cat({known, made});
    shown += fresh;
    const at::Tensor motion = model->denormalize(made).to(at::kCPU, at::kFloat);
    return articulate(motion.unflatten(1, {kNumLandmarks, 3}), options.generate.articulation);
  }

  at::Tensor advance(const at::Tensor& next, bool last) {
    const torch::NoGradGuard no_grad;
    const auto& own = model->options();
    FREETALK_CHECK(next.dim() == 2 && next.size(1) == own.audio_dim, "expected features (n, ",
                   own.audio_dim, "), found ", next.sizes());
    std::vector<at::Tensor> made = {at::empty({0, kNumLandmarks, 3}, at::kFloat)};
    const int64_t most = options.window_frames / 2 - options.redo_frames;
    for (int64_t at = 0; at < next.size(0); at += most) {
      made.push_back(step(next.slice(0, at, at + most), options.redo_frames));
    }
    if (last && shown < heard) made.push_back(step(next.slice(0, 0, 0), 0));
    return at::cat(made);
  }
};

MotionStream::MotionStream(Ats model, std::vector<EmotionKey> emotions, uint64_t seed,
                           const MotionStreamOptions& options) {
  core::with_plain_errors("MotionStream", [&] {
    options.check();
    FREETALK_CHECK(!emotions.empty(), "expected at least one emotion");
    state_ = std::make_unique<State>(std::move(model), std::move(emotions), seed, options);
  });
}

MotionStream::~MotionStream() = default;
MotionStream::MotionStream(MotionStream&&) noexcept = default;

at::Tensor MotionStream::push(const at::Tensor& features) {
  return core::with_plain_errors("MotionStream",
                                 [&] { return state_->advance(features, /*last=*/false); });
}

at::Tensor MotionStream::finish(const at::Tensor& features) {
  return core::with_plain_errors("MotionStream", [&] {
    const at::Tensor rest = state_->advance(features, /*last=*/true);
    state_->reset();
    return rest;
  });
}

void MotionStream::reset() { state_->reset(); }

void MotionStream::set_emotion(const std::vector<EmotionKey>& next, double time_s) {
  core::with_plain_errors("MotionStream", [&] {
    FREETALK_CHECK(!next.empty(), "expected at least one emotion");
    auto& keys = state_->keys;
    const EmotionKey now = at_time(keys, time_s);
    while (!keys.empty() && keys.back().time_s >= time_s) keys.pop_back();
    keys.push_back(now);
    for (const EmotionKey& key : next) {
      keys.push_back(
          {time_s + state_->options.emotion_ramp_s + key.time_s, key.emotion, key.intensity});
    }
  });
}

int64_t MotionStream::num_held() const {
  const State& s = *state_;
  return s.features.numel() + s.noise.numel() + s.known.numel() + s.drawn.numel() +
         static_cast<int64_t>(s.keys.size());
}

}  // namespace freetalk::ats
