#include "facetalk/inference.h"

#include <ATen/ATen.h>

#include <utility>

#include "core/autocast.h"

namespace freetalk::facetalk {

Inference::Inference(FaceTalk model, const std::vector<int64_t>& timesteps, double guidance,
                     at::ScalarType dtype)
    : model_(std::move(model)), guidance_(guidance), dtype_(dtype) {
  const at::Tensor& weight = model_->null_audio_;
  const at::Tensor codes =
      model_->time_code(at::tensor(timesteps, weight.options().dtype(at::kLong)));
  for (size_t i = 0; i < timesteps.size(); ++i) {
    Step& step = steps_[timesteps[i]];
    step.code = codes.narrow(0, static_cast<int64_t>(i), 1);
    for (nn::FilmDecoderLayer& layer : model_->layers_) {
      step.terms.push_back(layer->terms(step.code));
    }
  }
  reset();
}

void Inference::reset() {
  next_ = 0;
  for (auto& [timestep, step] : steps_) step.past.assign(model_->layers_.size(), {});
}

void Inference::hear(const at::Tensor& features, int64_t num_motions) {
  const core::Bfloat16Scope bfloat16(features.device().type(), dtype_ == at::kBFloat16);
  const int64_t frames = features.size(0);
  at::Tensor memory = model_->memory(features.unsqueeze(0), {}, next_);
  if (guidance_ != 1) {
    const at::Tensor all = at::ones({1}, features.options().dtype(at::kBool));
    memory = at::cat({memory, model_->memory(features.unsqueeze(0), all, next_)});
  }
  heard_.clear();
  for (nn::FilmDecoderLayer& layer : model_->layers_) {
    const at::Tensor heard = layer->heard(memory).unsqueeze(1);  // (1 or 2, 1, n, d)
    heard_.push_back(heard.expand({-1, num_motions, -1, -1}).flatten(0, 1));
  }
  positions_ = model_->input_positions(next_, frames);
  span_ = model_->span(next_, frames, features.options());
  next_ += frames;
}

at::Tensor Inference::denoise(const at::Tensor& x, int64_t timestep) {
  const core::Bfloat16Scope bfloat16(x.device().type(), dtype_ == at::kBFloat16);
  Step& step = steps_.at(timestep);
  const at::Tensor both = guidance_ == 1 ? x : x.repeat({2, 1, 1});
  const at::Tensor x0 =
      model_->decode(both, step.code, positions_, heard_, {}, step.terms, span_, &step.past)
          .to(at::kFloat);
  if (guidance_ == 1) return x0;
  const auto halves = x0.chunk(2);
  return halves[0] * guidance_ + halves[1] * (1 - guidance_);
}

int64_t Inference::num_held() const {
  int64_t count = 0;
  for (const auto& [timestep, step] : steps_) {
    for (const nn::PastFrames& past : step.past) {
      if (past.keys.defined()) count += past.keys.numel() + past.values.numel();
    }
  }
  return count;
}

}  // namespace freetalk::facetalk
