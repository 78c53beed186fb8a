#include "ats/inference.h"

#include <ATen/ATen.h>

#include "freetalk/core/error.h"

namespace freetalk::ats {

AtsInference::AtsInference(AtsImpl& model, const std::vector<int64_t>& timesteps,
                           at::ScalarType dtype, int64_t rows)
    : model_(model),
      dtype_(dtype),
      input_(model.input_proj_->weight, model.input_proj_->bias, dtype, rows),
      output_(model.output_proj_->weight, model.output_proj_->bias, dtype, rows) {
  const auto whole = model.null_audio_.options().dtype(at::kLong);
  const at::Tensor codes = model.time_code(at::tensor(timesteps, whole));
  for (size_t i = 0; i < timesteps.size(); ++i) {
    time_codes_[timesteps[i]] = codes[static_cast<int64_t>(i)];
  }
  for (const nn::TransformerDecoderLayer& layer : model.layers_) {
    layers_.emplace_back(*layer, dtype, rows);
  }
}

AtsInference::Prepared AtsInference::prepare(const at::Tensor& audio, const Affect& affect,
                                             bool null_audio, int64_t known) {
  Condition condition;
  condition.audio = audio;
  condition.emotion = affect.emotion;
  condition.intensity = affect.intensity;
  const at::Tensor codes = model_.affect_code(condition);  // (K, 1, d)
  const int64_t num_frames = audio.size(1);
  const at::Tensor positions = model_.target_positions_.narrow(0, 0, num_frames);
  Prepared prepared{
      {num_frames, model_.options_.band_radius, dtype_, audio.device()}, {}, known, {}};
  prepared.base = positions + at::cat({codes, model_.null_affect_.view({1, 1, -1})});
  if (known > 0) {
    const auto whole = audio.options().dtype(at::kLong);
    prepared.base.narrow(1, 0, known).add_(model_.time_code(at::zeros({1}, whole)));
  }
  at::Tensor memory = model_.audio_memory(condition);  // (W, T, d)
  if (null_audio) {
    condition.drop_audio = at::ones({audio.size(0)}, audio.options().dtype(at::kBool));
    memory = at::cat({memory, model_.audio_memory(condition)});
  }
  memory = memory.to(dtype_);
  for (const nn::DecoderLayerInference& layer : layers_) {
    prepared.memory.push_back(layer.remember(memory, prepared.band.margin()));
  }
  return prepared;
}

at::Tensor AtsInference::denoise(const at::Tensor& x, int64_t timestep, const Prepared& prepared,
                                 const std::vector<Variant>& variants) const {
  std::vector<at::Tensor> base;
  std::vector<int64_t> memory_of;
  for (const Variant& variant : variants) {
    base.push_back(prepared.base[variant.affect]);
    memory_of.push_back(variant.null_audio ? 1 : 0);
  }
  at::Tensor code = at::stack(base);  // (G, T, d)
  code.slice(1, prepared.known).add_(time_codes_.at(timestep));
  const at::Tensor start =
      code.to(dtype_).unsqueeze(1).expand({-1, x.size(1), -1, -1}).flatten(0, 1);
  at::Tensor z = input_.add(x.to(dtype_).flatten(0, 1), start);  // (G W, T, d)
  for (size_t i = 0; i < layers_.size(); ++i) {
    z = layers_[i].forward(z, prepared.memory[i], memory_of, prepared.band);
  }
  if (model_.options_.norm_first) {
    z = at::layer_norm(z, {z.size(-1)}, model_.norm_->weight.to(dtype_),
                       model_.norm_->bias.to(dtype_), model_.norm_->options.eps());
  }
  return output_(z).to(x.scalar_type()).view(x.sizes());
}

}  // namespace freetalk::ats
