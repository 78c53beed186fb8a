#include "freetalk/ats/generate.h"

#include <torch/torch.h>

#include <algorithm>
#include <utility>

#include "freetalk/core/error.h"
#include "freetalk/core/torch_error.h"
#include "window_group.h"

namespace freetalk::ats {
namespace {

void check_inputs(const AtsOptions& own, const at::Tensor& features, const Affect& affect,
                  const std::vector<at::Generator>& generators) {
  FREETALK_CHECK(features.dim() == 2 && features.size(0) > 0 && features.size(1) == own.audio_dim,
                 "generate: expected features (T, ", own.audio_dim, "), found ", features.sizes());
  const auto count = static_cast<int64_t>(own.emotions.size());
  const bool single = !affect.weight.defined();
  const int64_t keys = single ? 1 : affect.weight.size(-1);
  FREETALK_CHECK(affect.emotion.sizes() == at::IntArrayRef({keys, count}),
                 "generate: expected emotion (", keys, ", ", count, "), found ",
                 affect.emotion.sizes());
  FREETALK_CHECK(affect.intensity.sizes() == at::IntArrayRef({keys}),
                 "generate: expected an intensity for each emotion, found ",
                 affect.intensity.sizes(), " for ", keys);
  FREETALK_CHECK(single || affect.weight.sizes() == at::IntArrayRef({features.size(0), keys}),
                 "generate: expected a weight of every emotion for ", features.size(0),
                 " frames, found ", affect.weight.sizes());
  const double least = affect.intensity.min().item<double>();
  const double most = affect.intensity.max().item<double>();
  FREETALK_CHECK(least >= 1 && most <= static_cast<double>(own.num_intensities),
                 "intensity must be between 1 and ", own.num_intensities, ", found ",
                 least < 1 ? least : most);
  FREETALK_CHECK(!generators.empty(), "generate: expected at least one generator");
}

Affect of_frames(const Affect& affect, int64_t first, int64_t count) {
  if (!affect.weight.defined()) return affect;
  return {affect.emotion, affect.intensity, affect.weight.narrow(0, first, count)};
}

}  // namespace

diffusion::SamplerOptions GenerateOptions::sampler_options() const {
  return {sampler, num_steps, eta, spacing};
}

void GenerateOptions::check() const {
  sampler_options().check();
  FREETALK_CHECK(std::isfinite(audio_guidance) && std::isfinite(affect_guidance),
                 "audio_guidance and affect_guidance must be finite");
  FREETALK_CHECK(mouth_temperature >= 0 && mouth_temperature <= 1,
                 "mouth_temperature must be between 0 and 1, found ", mouth_temperature);
  FREETALK_CHECK(articulation > 0 && articulation <= 3,
                 "articulation must be above 0 and at most 3, found ", articulation);
  FREETALK_CHECK(window_overlap >= 0, "window_overlap must not be negative, found ",
                 window_overlap);
  FREETALK_CHECK(windows_per_batch > 0, "windows_per_batch must be positive, found ",
                 windows_per_batch);
  FREETALK_CHECK(precision == "float32" || precision == "bfloat16",
                 "precision must be float32 or bfloat16, found '", precision, "'");
}

std::vector<int64_t> window_starts(int64_t num_frames, int64_t window, int64_t overlap) {
  FREETALK_CHECK(window > 0 && overlap >= 0 && overlap < std::max<int64_t>(window, 1),
                 "windows of ", window, " frames cannot overlap by ", overlap);
  if (num_frames <= window) return {0};
  const int64_t span = num_frames - window, step = window - overlap;
  const int64_t count = (span + step - 1) / step;
  std::vector<int64_t> starts;
  for (int64_t i = 0; i <= count; ++i) starts.push_back(span * i / count);
  return starts;
}

at::Tensor generate(Ats& model, const at::Tensor& features, const Affect& affect,
                    const GenerateOptions& options, std::vector<at::Generator> generators,
                    const diffusion::StepCallback& on_step) {
  return core::with_plain_errors("generate", [&] {
    const torch::NoGradGuard no_grad;
    options.check();
    const AtsOptions& own = model->options();
    check_inputs(own, features, affect, generators);
    const diffusion::Schedule schedule(own.schedule_options());
    const auto sampling = options.sampler_options();
    const WindowPlan plan = plan_windows(features.size(0), own.window_frames(), options);
    const auto dtype = options.precision == "bfloat16" ? at::kBFloat16 : features.scalar_type();
    AtsInference network(
        *model, diffusion::sampler_timesteps(schedule, sampling), dtype,
        plan.window * std::min<int64_t>(static_cast<int64_t>(plan.groups[0].size()),
                                        options.windows_per_batch));
    const Affect felt{
        affect.emotion.to(features.options()), affect.intensity.to(features.options()),
        affect.weight.defined() ? affect.weight.to(features.options()) : at::Tensor()};
    std::vector<at::Tensor> start;
    for (const at::Generator& generator : generators) {
      start.push_back(at::randn({features.size(0), kMotionDim}, generator, features.options()));
    }
    const at::Tensor amount = noise_amount(options, features);
    const at::Tensor noise = at::stack(start) * amount;
    at::Tensor result = at::empty_like(noise);
    Shared shared;
    const auto count = static_cast<int64_t>(plan.groups.size());
    for (int64_t i = 0; i < count; ++i) {
      const auto index = static_cast<size_t>(i);
      const int64_t first = plan.first_frame(index), frames = plan.num_frames(index);
      std::vector<int64_t> starts = plan.groups[index];
      for (int64_t& window : starts) window -= first;
      WindowGroup group(network, plan, starts, features.narrow(0, first, frames),
                        of_frames(felt, first, frames), options, std::move(shared),
                        plan.shared_frames(index));
      const at::Tensor x0 = diffusion::sample(
          schedule,
          [&](const at::Tensor& x, int64_t timestep) { return group.denoise(x, timestep); },
          noise.narrow(1, first, frames), sampling,
          [&](const at::Tensor& like) { return group.draw(like, generators) * amount; },
          [&](int64_t done, int64_t total) {
            if (on_step) on_step(i * total + done, count * total);
          });
      result.narrow(1, first, frames).copy_(x0);
      shared = group.leave();
    }
    const at::Tensor motion = model->denormalize(result).to(at::kFloat);
    return articulate(motion.unflatten(2, {kNumLandmarks, 3}), options.articulation);
  });
}

at::Tensor generate(Ats& model, const at::Tensor& features, const at::Tensor& emotion,
                    double intensity, const GenerateOptions& options, at::Generator generator,
                    const diffusion::StepCallback& on_step) {
  return core::with_plain_errors("generate", [&] {
    FREETALK_CHECK(emotion.dim() == 1, "generate: expected emotion (E,), found ", emotion.sizes());
    return generate(model, features, constant_affect(emotion, intensity), options, {generator},
                    on_step)
        .squeeze(0);
  });
}

}  // namespace freetalk::ats
