#include "freetalk/ats/ats.h"

#include <torch/utils.h>

#include "freetalk/core/error.h"
#include "freetalk/core/torch_error.h"
#include "freetalk/nn/embedding.h"
#include "nn/local_start.h"

namespace freetalk::ats {

namespace {

constexpr int64_t kLocalRadius = 3;  // frames; of the first cross-attention where no band is set
constexpr int64_t kSelfRadius = 6;   // frames; of the first self-attention: a blink lasts about six

}  // namespace

void AtsOptions::check() const {
  nn::TransformerLayerOptions{d_model, num_heads, ff_dim, dropout, norm_first, activation}.check();
  FREETALK_CHECK(d_model % 2 == 0, "d_model must be even, found ", d_model);
  FREETALK_CHECK(num_layers > 0, "num_layers must be positive, found ", num_layers);
  FREETALK_CHECK(audio_dim > 0, "audio_dim must be positive, found ", audio_dim);
  FREETALK_CHECK(max_frames > 1, "max_frames must be at least 2, found ", max_frames);
  FREETALK_CHECK(trained_frames >= 0 && trained_frames <= max_frames,
                 "trained_frames must be between 0 and max_frames = ", max_frames, ", found ",
                 trained_frames);
  FREETALK_CHECK(band_radius >= -1, "band_radius must be >= 0, or -1 for no band, found ",
                 band_radius);
  FREETALK_CHECK(attention_start == "local" || attention_start == "random",
                 "attention_start must be local or random, found ", attention_start);
  FREETALK_CHECK(num_intensities > 0, "num_intensities must be positive, found ", num_intensities);
  FREETALK_CHECK(fps > 0, "fps must be positive, found ", fps);
  FREETALK_CHECK(!emotions.empty(), "emotions must name at least one emotion");
  schedule_options().check();
}

diffusion::ScheduleOptions AtsOptions::schedule_options() const {
  return {schedule, num_train_steps, beta_start, beta_end};
}

AtsImpl::AtsImpl(const AtsOptions& options) : options_(options) {
  options.check();
  const int64_t d = options.d_model;
  const auto num_emotions = static_cast<int64_t>(options.emotions.size());
  input_proj_ = register_module("input_proj", torch::nn::Linear(kMotionDim, d));
  memory_proj_ = register_module("memory_proj", torch::nn::Linear(options.audio_dim, d));
  output_proj_ = register_module("output_proj", torch::nn::Linear(d, kMotionDim));
  target_positions_ =
      register_parameter("target_positions", torch::randn({options.max_frames, d}) * 0.02);
  memory_positions_ =
      register_parameter("memory_positions", torch::randn({options.max_frames, d}) * 0.02);
  null_audio_ = register_parameter("null_audio", torch::zeros({options.audio_dim}));
  null_affect_ = register_parameter("null_affect", torch::zeros({d}));
  time_in_ = register_module("time_in", torch::nn::Linear(d, d));
  time_out_ = register_module("time_out", torch::nn::Linear(d, d));
  emotion_embedding_ = register_module("emotion_embedding", torch::nn::Embedding(num_emotions, d));
  intensity_embedding_ =
      register_module("intensity_embedding", torch::nn::Embedding(options.num_intensities, d));
  affect_in_ = register_module("affect_in", torch::nn::Linear(2 * d, d));
  affect_out_ = register_module("affect_out", torch::nn::Linear(d, d));
  const auto layer_list = register_module("layers", torch::nn::ModuleList());
  for (int64_t index = 0; index < options.num_layers; ++index) {
    layers_.emplace_back(nn::TransformerLayerOptions{d, options.num_heads, options.ff_dim,
                                                     options.dropout, options.norm_first,
                                                     options.activation});
    layer_list->push_back(layers_.back());
  }
  if (options.attention_start == "local") start_locally();
  if (options.norm_first) {
    norm_ = register_module("norm", torch::nn::LayerNorm(torch::nn::LayerNormOptions({d})));
  }
  motion_mean_ = register_buffer("motion_mean", torch::zeros({kMotionDim}));
  motion_scale_ = register_buffer("motion_scale", torch::ones({kMotionDim}));
}

void AtsImpl::start_locally() {
  const torch::NoGradGuard no_grad;
  const at::Tensor code =
      nn::local_position_code(options_.max_frames, options_.d_model, options_.num_heads);
  target_positions_.add_(code);
  memory_positions_.add_(code);
  const int64_t radius = options_.band_radius < 0 ? kLocalRadius : options_.band_radius;
  for (nn::TransformerDecoderLayer& layer : layers_) {
    nn::start_locally(layer->self_attention(), static_cast<double>(kSelfRadius));
    nn::start_locally(layer->cross_attention(), static_cast<double>(radius));
  }
}

void AtsImpl::check_inputs(const at::Tensor& x, const at::Tensor& timestep,
                           const Condition& condition) const {
  FREETALK_CHECK(x.dim() == 3 && x.size(2) == kMotionDim, "ATS: expected x (B, T, ", kMotionDim,
                 "), found ", x.sizes());
  const int64_t batch = x.size(0), frames = x.size(1);
  FREETALK_CHECK(frames <= options_.max_frames, "ATS: ", frames,
                 " frames exceed max_frames = ", options_.max_frames,
                 "; use generate(), which works in windows");
  const auto expect = [](const char* name, const at::Tensor& tensor, at::IntArrayRef sizes) {
    FREETALK_CHECK(tensor.sizes() == sizes, "ATS: expected ", name, " ", sizes, ", found ",
                   tensor.sizes());
  };
  expect("timestep", timestep, {batch});
  expect("audio", condition.audio, {batch, frames, options_.audio_dim});
  const auto num_emotions = static_cast<int64_t>(options_.emotions.size());
  if (condition.emotion.dim() == 3) {
    expect("emotion", condition.emotion, {batch, frames, num_emotions});
    expect("intensity (as emotion, of every frame)", condition.intensity, {batch, frames});
  } else {
    expect("emotion", condition.emotion, {batch, num_emotions});
    expect("intensity", condition.intensity, {batch});
  }
  if (condition.valid.defined()) expect("valid", condition.valid, {batch, frames});
  if (condition.drop_audio.defined()) expect("drop_audio", condition.drop_audio, {batch});
  if (condition.drop_affect.defined()) expect("drop_affect", condition.drop_affect, {batch});
  if (condition.first_position.defined()) {
    expect("first_position", condition.first_position, {batch});
  }
  if (condition.known.defined()) expect("known", condition.known, {batch});
}

at::Tensor AtsImpl::time_code(const at::Tensor& timestep) {
  const at::Tensor code =
      nn::sinusoidal_code(timestep, options_.d_model).to(time_in_->weight.scalar_type());
  return time_out_(at::silu(time_in_(code)));
}

at::Tensor AtsImpl::time_code_of_frames(const at::Tensor& timestep, const Condition& condition) {
  const at::Tensor code = time_code(timestep).unsqueeze(1);
  if (!condition.known.defined()) return code;
  const at::Tensor frame = at::arange(condition.audio.size(1), condition.known.options());
  const at::Tensor is_known = frame < condition.known.unsqueeze(1);  // (B, T)
  return at::where(is_known.unsqueeze(2), time_code(at::zeros_like(timestep)).unsqueeze(1), code);
}

at::Tensor AtsImpl::affect_code(const Condition& condition) {
  const bool changing = condition.emotion.dim() == 3;
  const at::Tensor mixture = changing ? condition.emotion : condition.emotion.unsqueeze(1);
  const at::Tensor emotion = mixture.matmul(emotion_embedding_->weight);  // (B, 1 or T, d)
  const at::Tensor level = ((changing ? condition.intensity : condition.intensity.unsqueeze(1)) - 1)
                               .clamp(0, static_cast<double>(options_.num_intensities - 1))
                               .unsqueeze(2);
  const at::Tensor levels = at::arange(options_.num_intensities, level.options());
  const at::Tensor hat =
      (1 - (level - levels).abs()).clamp_min(0);  // (B, 1 or T, levels): interpolation weights
  const at::Tensor intensity = hat.matmul(intensity_embedding_->weight);
  const at::Tensor code = affect_out_(at::silu(affect_in_(at::cat({emotion, intensity}, 2))));
  if (!condition.drop_affect.defined()) return code;
  return at::where(condition.drop_affect.view({-1, 1, 1}), null_affect_.to(code.scalar_type()),
                   code);
}

at::Tensor AtsImpl::audio_memory(const Condition& condition) {
  at::Tensor audio = condition.audio;
  if (condition.drop_audio.defined()) {
    audio = at::where(condition.drop_audio.view({-1, 1, 1}), null_audio_, audio);
  }
  return memory_proj_(audio) + positions_of(memory_positions_, condition);
}

at::Tensor AtsImpl::positions_of(const at::Tensor& table, const Condition& condition) const {
  const int64_t frames = condition.audio.size(1);
  const at::Tensor& first = condition.first_position;
  if (!first.defined()) return table.narrow(0, 0, frames);
  // Padding may reach beyond the table; nobody reads it.
  const at::Tensor index = first.unsqueeze(1) + at::arange(frames, first.options());
  return at::embedding(table, index.clamp_max(table.size(0) - 1));
}

at::Tensor AtsImpl::forward(const at::Tensor& x, const at::Tensor& timestep,
                            const Condition& condition) {
  return core::with_plain_errors("ATS", [&] {
    check_inputs(x, timestep, condition);
    const int64_t frames = x.size(1);
    at::Tensor cross_allowed =
        nn::band_mask(frames, options_.band_radius < 0 ? frames : options_.band_radius, x.device());
    at::Tensor self_allowed;
    if (condition.valid.defined()) {
      // A padded frame attends to itself only: its row must not be empty, and nobody reads it.
      const at::Tensor itself = nn::band_mask(frames, 0, x.device());
      const at::Tensor key_valid = condition.valid.view({-1, 1, 1, frames});
      self_allowed = key_valid.logical_or(itself);
      cross_allowed = key_valid.logical_and(cross_allowed).logical_or(itself);
    }
    const at::Tensor memory = audio_memory(condition);
    at::Tensor z = input_proj_(x) + positions_of(target_positions_, condition) +
                   time_code_of_frames(timestep, condition) + affect_code(condition);
    for (nn::TransformerDecoderLayer& layer : layers_)
      z = layer(z, memory, self_allowed, cross_allowed);
    return output_proj_(options_.norm_first ? norm_(z) : z);
  });
}

at::Tensor AtsImpl::normalize(const at::Tensor& motion) const {
  return (motion - motion_mean_) / motion_scale_;
}

at::Tensor AtsImpl::denormalize(const at::Tensor& motion) const {
  return motion * motion_scale_ + motion_mean_;
}

void AtsImpl::set_motion_statistics(const at::Tensor& mean, const at::Tensor& scale) {
  FREETALK_CHECK(mean.sizes() == motion_mean_.sizes() && scale.sizes() == motion_scale_.sizes(),
                 "motion statistics: expected (", kMotionDim, ",), found ", mean.sizes(), " and ",
                 scale.sizes());
  FREETALK_CHECK(scale.gt(0).all().item<bool>(), "motion_scale must be positive");
  motion_mean_.copy_(mean);
  motion_scale_.copy_(scale);
}

}  // namespace freetalk::ats
