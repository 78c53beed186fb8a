#include "freetalk/facetalk/facetalk.h"

#include <torch/utils.h>

#include <array>
#include <utility>

#include "core/autocast.h"
#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "freetalk/core/torch_error.h"
#include "freetalk/nn/embedding.h"

namespace freetalk::facetalk {

namespace {

constexpr double kLandmarkScale = 200.0;  // 1 / m: landmarks that move by 5 mm count one

}  // namespace

void FaceTalkOptions::check() const {
  layer_options().check();
  FREETALK_CHECK(codes == "head" || codes == "weights", "codes must be head or weights, found '",
                 codes, "'");
  FREETALK_CHECK(codes != "weights" || static_cast<int64_t>(expressions.size()) == code_dim,
                 "codes that are weights need a name for each of the ", code_dim, ", found ",
                 expressions.size());
  FREETALK_CHECK(condition == "audio" || condition == "landmarks",
                 "condition must be audio or landmarks, found '", condition, "'");
  FREETALK_CHECK(condition == "audio" || audio_dim == core::kMotionDim,
                 "a model that is conditioned on landmarks has audio_dim ", core::kMotionDim,
                 ", found ", audio_dim);
  FREETALK_CHECK(code_dim > 0 && audio_dim > 0, "code_dim and audio_dim must be positive, found ",
                 code_dim, " and ", audio_dim);
  FREETALK_CHECK(d_model % 2 == 0, "d_model must be even, found ", d_model);
  FREETALK_CHECK(num_layers > 0, "num_layers must be positive, found ", num_layers);
  FREETALK_CHECK(time_layers == 2 || time_layers == 3, "time_layers must be 2 or 3, found ",
                 time_layers);
  FREETALK_CHECK(positions == "rotary" || positions == "learned",
                 "positions must be rotary or learned, found '", positions, "'");
  FREETALK_CHECK(positions != "rotary" || (d_model / num_heads) % 2 == 0,
                 "rotary positions need an even number of channels a head, found ", d_model, " / ",
                 num_heads);
  FREETALK_CHECK(max_frames > 1, "max_frames must be at least 2, found ", max_frames);
  FREETALK_CHECK(fps > 0, "fps must be positive, found ", fps);
  FREETALK_CHECK(feature_resampling == "conv" || feature_resampling == "output",
                 "feature_resampling must be conv or output, found '", feature_resampling, "'");
  schedule_options().check();
}

diffusion::ScheduleOptions FaceTalkOptions::schedule_options() const {
  return {schedule, num_train_steps, beta_start, beta_end};
}

nn::FilmLayerOptions FaceTalkOptions::layer_options() const {
  return {{d_model, num_heads, ff_dim, dropout, norm_first, activation},
          time_condition,
          film_form,
          align_audio,
          window};
}

FaceTalkImpl::FaceTalkImpl(const FaceTalkOptions& options) : options_(options) {
  options.check();
  const int64_t d = options.d_model, dim = options.code_dim;
  input_proj_ = register_module("input_proj", torch::nn::Linear(dim, d));
  audio_proj_ = register_module("audio_proj", torch::nn::Linear(options.audio_dim, d));
  output_proj_ = register_module("output_proj", torch::nn::Linear(d, dim));
  const auto mlp = register_module("time_mlp", torch::nn::ModuleList());
  for (int64_t layer = 0; layer < options.time_layers; ++layer) {
    time_mlp_.emplace_back(d, d);
    mlp->push_back(time_mlp_.back());
  }
  const auto layer_list = register_module("layers", torch::nn::ModuleList());
  for (int64_t index = 0; index < options.num_layers; ++index) {
    layers_.emplace_back(options.layer_options());
    layer_list->push_back(layers_.back());
  }
  if (options.norm_first) {
    norm_ = register_module("norm", torch::nn::LayerNorm(torch::nn::LayerNormOptions({d})));
  }
  if (options.positions == "learned") {
    positions_ = register_parameter("positions", torch::randn({options.max_frames, d}) * 0.02);
  }
  null_audio_ = register_parameter("null_audio", torch::zeros({options.audio_dim}));
  code_mean_ = register_buffer("code_mean", torch::zeros({dim}));
  code_scale_ = register_buffer("code_scale", torch::ones({dim}));
  rest_code_ = register_buffer("rest_code", torch::zeros({dim}));
  landmark_basis_ = register_buffer("landmark_basis", torch::zeros({dim, core::kMotionDim}));
}

void FaceTalkImpl::check_inputs(const at::Tensor& x, const at::Tensor& timestep,
                                const Condition& condition) const {
  FREETALK_CHECK(x.dim() == 3 && x.size(2) == options_.code_dim, "FaceTalk: expected x (B, T, ",
                 options_.code_dim, "), found ", x.sizes());
  const int64_t batch = x.size(0), frames = x.size(1);
  const auto expect = [](const char* name, const at::Tensor& tensor, at::IntArrayRef sizes) {
    FREETALK_CHECK(tensor.sizes() == sizes, "FaceTalk: expected ", name, " ", sizes, ", found ",
                   tensor.sizes());
  };
  expect("timestep", timestep, {batch});
  expect("audio", condition.audio, {batch, frames, options_.audio_dim});
  if (condition.drop_audio.defined()) expect("drop_audio", condition.drop_audio, {batch});
  if (condition.valid.defined()) expect("valid", condition.valid, {batch, frames});
}

at::Tensor FaceTalkImpl::time_code(const at::Tensor& timestep) {
  at::Tensor code =
      nn::sinusoidal_code(timestep, options_.d_model).to(time_mlp_[0]->weight.scalar_type());
  for (size_t layer = 0; layer < time_mlp_.size(); ++layer) {
    code = time_mlp_[layer](layer > 0 ? at::silu(code) : code);
  }
  return code;
}

at::Tensor FaceTalkImpl::memory(const at::Tensor& audio, const at::Tensor& drop_audio,
                                int64_t first) {
  at::Tensor heard = options_.condition == "landmarks" ? audio * kLandmarkScale : audio;
  if (drop_audio.defined()) heard = at::where(drop_audio.view({-1, 1, 1}), null_audio_, heard);
  const at::Tensor memory = audio_proj_(heard);
  if (options_.align_audio) return memory;
  const at::Tensor frames = at::arange(first, first + audio.size(1), audio.options());
  return memory + nn::sinusoidal_code(frames, options_.d_model);
}

nn::CausalSpan FaceTalkImpl::span(int64_t first, int64_t num_frames,
                                  const at::TensorOptions& options) const {
  return nn::causal_span(first, num_frames, options_.window, options_.d_model / options_.num_heads,
                         options_.positions == "rotary", options);
}

at::Tensor FaceTalkImpl::input_positions(int64_t first, int64_t num_frames) const {
  if (options_.positions == "learned") {
    FREETALK_CHECK(first + num_frames <= options_.max_frames, "FaceTalk: ", first + num_frames,
                   " frames exceed the max_frames = ", options_.max_frames,
                   " that positions were learned for; rotary positions have no such limit");
    return positions_.narrow(0, first, num_frames);
  }
  if (options_.align_audio) return {};
  // Whoever hears the whole clip has to know where in it it is.
  const at::Tensor frames = at::arange(first, first + num_frames, code_mean_.options());
  return nn::sinusoidal_code(frames, options_.d_model);
}

at::Tensor FaceTalkImpl::decode(const at::Tensor& x, const at::Tensor& code,
                                const at::Tensor& positions, const std::vector<at::Tensor>& heard,
                                const at::Tensor& heard_valid,
                                const std::vector<nn::PlaceTerms>& terms,
                                const nn::CausalSpan& span, std::vector<nn::PastFrames>* past) {
  at::Tensor z = input_proj_(options_.diffusion ? x : at::zeros_like(x));
  if (positions.defined()) z = z + positions;
  if (options_.time_condition == "input") z = z + code.unsqueeze(1);
  for (size_t i = 0; i < layers_.size(); ++i) {
    z = layers_[i](z, heard[i], heard_valid, terms[i], span,
                   past != nullptr ? &(*past)[i] : nullptr);
  }
  return output_proj_(options_.norm_first ? norm_(z) : z);
}

at::Tensor FaceTalkImpl::forward(const at::Tensor& x, const at::Tensor& timestep,
                                 const Condition& condition) {
  return core::with_plain_errors("FaceTalk", [&] {
    check_inputs(x, timestep, condition);
    const int64_t frames = x.size(1);
    const at::Tensor code = time_code(timestep);
    const at::Tensor remembered = memory(condition.audio, condition.drop_audio, 0);
    at::Tensor heard_valid;
    if (condition.valid.defined()) heard_valid = condition.valid.view({-1, 1, 1, frames});
    std::vector<at::Tensor> heard;
    std::vector<nn::PlaceTerms> terms;
    for (nn::FilmDecoderLayer& layer : layers_) {
      heard.push_back(layer->heard(remembered));
      terms.push_back(layer->terms(code));
    }
    return decode(x, code, input_positions(0, frames), heard, heard_valid, terms,
                  span(0, frames, x.options()), nullptr);
  });
}

at::Tensor FaceTalkImpl::normalize(const at::Tensor& codes) const {
  return (codes - code_mean_) / code_scale_;
}

at::Tensor FaceTalkImpl::denormalize(const at::Tensor& codes) const {
  return codes * code_scale_ + code_mean_;
}

void FaceTalkImpl::set_code_statistics(const at::Tensor& mean, const at::Tensor& scale,
                                       const at::Tensor& rest, const at::Tensor& landmark_basis) {
  const std::array<std::pair<const at::Tensor*, at::Tensor*>, 4> pairs{
      {{&mean, &code_mean_},
       {&scale, &code_scale_},
       {&rest, &rest_code_},
       {&landmark_basis, &landmark_basis_}}};
  for (const auto& [given, own] : pairs) {
    FREETALK_CHECK(given->sizes() == own->sizes(), "code statistics: expected ", own->sizes(),
                   ", found ", given->sizes());
    FREETALK_CHECK(given->isfinite().all().item<bool>(), "code statistics must be finite");
  }
  FREETALK_CHECK(scale.gt(0).all().item<bool>(), "code_scale must be positive");
  for (const auto& [given, own] : pairs) own->copy_(*given);
}

at::Tensor FaceTalkImpl::landmarks(const at::Tensor& codes) const {
  const core::NoAutocastScope no_autocast;  // lips that meet are small differences
  return (codes - rest_code_).matmul(landmark_basis_).unflatten(-1, {core::kNumLandmarks, 3});
}

}  // namespace freetalk::facetalk
