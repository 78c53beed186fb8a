#include "freetalk/speech/encoder.h"

#include <torch/torch.h>

#include <algorithm>

#include "freetalk/core/error.h"
#include "inference_cache.h"
#include "layers.h"

namespace freetalk::speech {
namespace {

/// Real samples per clip, (B,) int64 on the mask's device; nothing when every sample is real.
std::optional<at::Tensor> mask_lengths(const at::Tensor& wave, const at::Tensor& mask,
                                       int64_t receptive_field) {
  FREETALK_CHECK(mask.sizes() == wave.sizes(), "mask has shape ", mask.sizes(), ", wave ",
                 wave.sizes(), ": they must agree");
  const auto real = mask != 0;
  const auto lengths = real.sum(1);
  const auto positions = at::arange(1, mask.size(1) + 1, lengths.options());
  const auto last = (real * positions).amax(1);  // equals the length when ones come first
  const auto host = at::stack({lengths, last}).cpu();
  FREETALK_CHECK(host[0].equal(host[1]),
                 "mask has gaps: each row must be ones, then zeros (pad at the end)");
  const int64_t shortest = host[0].min().item<int64_t>();
  FREETALK_CHECK(shortest >= receptive_field, "mask leaves a clip of ", shortest,
                 " samples: the encoder needs at least ", receptive_field);
  if (shortest == wave.size(1)) {
    return std::nullopt;
  }
  return lengths;
}

}  // namespace

SpeechEncoderImpl::SpeechEncoderImpl(SpeechEncoderOptions options)
    : torch::nn::Module("SpeechEncoder"), options_(std::move(options)) {
  options_.check();
  feature_extractor_ =
      register_module("feature_extractor", std::make_shared<FeatureExtractorImpl>(options_));
  feature_projection_ =
      register_module("feature_projection", std::make_shared<FeatureProjectionImpl>(options_));
  encoder_ = register_module("encoder", std::make_shared<TransformerImpl>(options_));
  torch::NoGradGuard no_grad;
  feature_extractor_->initialize(options_);
  feature_projection_->initialize(options_);
  encoder_->initialize(options_);
  inference_ = std::make_unique<InferenceCache>();
}

SpeechEncoderImpl::~SpeechEncoderImpl() = default;

void SpeechEncoderImpl::train(bool on) {
  torch::nn::Module::train(on);
  if (on) {
    inference_->clear();
  }
}

std::optional<at::Tensor> SpeechEncoderImpl::check_wave(
    const at::Tensor& wave, const std::optional<at::Tensor>& mask) const {
  FREETALK_CHECK(wave.dim() == 2, "wave has shape ", wave.sizes(), ": expected (B, S)");
  FREETALK_CHECK(wave.is_floating_point(), "wave is of type ", wave.scalar_type(),
                 ": expected floating point samples");
  FREETALK_CHECK(num_frames(wave.size(1)) > 0, "wave has ", wave.size(1),
                 " samples: the encoder needs at least ", receptive_field());
  if (!mask) {
    return std::nullopt;
  }
  return mask_lengths(wave, *mask, receptive_field());
}

std::optional<at::Tensor> SpeechEncoderImpl::count_frames(
    std::optional<at::Tensor> num_samples) const {
  auto count = std::move(num_samples);
  for (size_t i = 0; count && i < options_.conv_dim.size(); ++i) {
    count = at::floor_divide(*count - options_.conv_kernel[i], options_.conv_stride[i]) + 1;
    count = count->clamp_min(0);
  }
  return count;
}

at::Tensor SpeechEncoderImpl::extract(const at::Tensor& wave,
                                      const std::optional<at::Tensor>& valid,
                                      const WindowMoments* moments) {
  if (const auto dtype = fast_dtype(wave, *feature_extractor_, /*has_dropout=*/false)) {
    return extract_fast(wave, valid, moments, *dtype);
  }
  return feature_extractor_->forward(wave, valid, moments);
}

at::Tensor SpeechEncoderImpl::extract_fast(const at::Tensor& wave,
                                           const std::optional<at::Tensor>& valid,
                                           const WindowMoments* moments, at::ScalarType dtype) {
  const FastScope scope;
  const auto network = inference_->get(*this, dtype);
  const int64_t kernel = options_.conv_kernel[0], stride = options_.conv_stride[0];
  const auto lengths = host_lengths(valid, wave.size(0), wave.size(1));
  auto result = at::zeros({wave.size(0), num_frames(wave.size(1)), options_.conv_dim.back()},
                          wave.options().dtype(dtype));
  for (int64_t row = 0; row < wave.size(0); ++row) {
    const int64_t length = lengths[static_cast<size_t>(row)];
    const auto samples = wave[row].to(at::kFloat).contiguous();
    std::optional<WindowMoments> own;
    if (options_.feat_extract_norm == "group") {
      const int64_t counted = options_.mask_group_norm ? length : wave.size(1);
      own = moments != nullptr
                ? *moments
                : window_moments(samples, kernel, stride, (counted - kernel) / stride + 1);
    }
    const auto features = network->extract(samples.narrow(0, 0, length), own);
    if (wave.size(0) == 1 && features.size(0) == result.size(1)) {
      return features.unsqueeze(0).to(wave.scalar_type());
    }
    result[row].narrow(0, 0, features.size(0)).copy_(features);
  }
  return result.to(wave.scalar_type());
}

at::Tensor SpeechEncoderImpl::encode(const at::Tensor& features,
                                     const std::optional<at::Tensor>& valid_frames, int64_t layer,
                                     std::vector<at::Tensor>* states) {
  FREETALK_CHECK(features.dim() == 3 && features.size(2) == options_.conv_dim.back(),
                 "features have shape ", features.sizes(), ": expected (B, S', ",
                 options_.conv_dim.back(), ")");
  FREETALK_CHECK(!valid_frames || valid_frames->sizes() == at::IntArrayRef({features.size(0)}),
                 "valid_frames must have shape (B,) = (", features.size(0), ",)");
  FREETALK_CHECK(
      layer >= -1 && layer <= options_.num_hidden_layers, "layer is ", layer,
      ": it must be -1 (the last) or 0 to num_hidden_layers = ", options_.num_hidden_layers);
  layer = layer < 0 ? options_.num_hidden_layers : layer;
  if (const auto dtype = fast_dtype(features, *this, /*has_dropout=*/true)) {
    return encode_fast(features, valid_frames, layer, states, *dtype);
  }
  return encoder_->forward(feature_projection_->forward(features), valid_frames, layer, states);
}

at::Tensor SpeechEncoderImpl::encode_fast(const at::Tensor& features,
                                          const std::optional<at::Tensor>& valid_frames,
                                          int64_t layer, std::vector<at::Tensor>* states,
                                          at::ScalarType dtype) {
  const FastScope scope;
  const auto network = inference_->get(*this, dtype);
  const auto lengths = host_lengths(valid_frames, features.size(0), features.size(1));
  std::vector<at::Tensor> parts;  // clips without their padding
  for (size_t row = 0; row < lengths.size(); ++row) {
    parts.push_back(features[static_cast<int64_t>(row)].narrow(0, 0, lengths[row]));
  }
  const auto restore = [&](const at::Tensor& packed) {  // (N, C) -> (B, S', C), zeros as padding
    const auto result =
        at::zeros({features.size(0), features.size(1), options_.hidden_size}, features.options());
    const auto clips = packed.split_with_sizes(lengths);
    for (size_t row = 0; row < lengths.size(); ++row) {
      result[static_cast<int64_t>(row)].narrow(0, 0, lengths[row]).copy_(clips[row]);
    }
    return result;
  };
  const auto last = network->encode(at::cat(parts), lengths, layer, states);
  if (states != nullptr) {
    std::transform(states->begin(), states->end(), states->begin(), restore);
    return states->back();
  }
  return restore(last);
}

at::Tensor SpeechEncoderImpl::extract_features(const at::Tensor& wave,
                                               const std::optional<at::Tensor>& mask) {
  return extract(wave, check_wave(wave, mask), nullptr);
}

at::Tensor SpeechEncoderImpl::encode_features(const at::Tensor& features,
                                              const std::optional<at::Tensor>& valid_frames,
                                              int64_t layer) {
  return encode(features, valid_frames, layer, nullptr);
}

std::vector<at::Tensor> SpeechEncoderImpl::encode_states(
    const at::Tensor& features, const std::optional<at::Tensor>& valid_frames) {
  std::vector<at::Tensor> states;
  encode(features, valid_frames, -1, &states);
  return states;
}

at::Tensor SpeechEncoderImpl::forward(const at::Tensor& wave, const std::optional<at::Tensor>& mask,
                                      int64_t layer) {
  const auto valid = check_wave(wave, mask);
  return encode(extract(wave, valid, nullptr), count_frames(valid), layer, nullptr);
}

std::vector<at::Tensor> SpeechEncoderImpl::hidden_states(const at::Tensor& wave,
                                                         const std::optional<at::Tensor>& mask) {
  const auto valid = check_wave(wave, mask);
  std::vector<at::Tensor> states;
  encode(extract(wave, valid, nullptr), count_frames(valid), -1, &states);
  return states;
}

int64_t SpeechEncoderImpl::num_frames(int64_t num_samples) const {
  int64_t count = num_samples;
  for (size_t i = 0; i < options_.conv_dim.size(); ++i) {
    if (count < options_.conv_kernel[i]) {
      return 0;
    }
    count = (count - options_.conv_kernel[i]) / options_.conv_stride[i] + 1;
  }
  return count;
}

int64_t SpeechEncoderImpl::receptive_field() const {
  int64_t field = 1;
  for (size_t i = options_.conv_dim.size(); i-- > 0;) {
    field = (field - 1) * options_.conv_stride[i] + options_.conv_kernel[i];
  }
  return field;
}

int64_t SpeechEncoderImpl::frame_stride() const {
  int64_t stride = 1;
  for (const int64_t factor : options_.conv_stride) {
    stride *= factor;
  }
  return stride;
}

FrameTiming SpeechEncoderImpl::timing() const {
  const double rate_hz = static_cast<double>(kSampleRateHz);
  return {rate_hz / static_cast<double>(frame_stride()),
          0.5 * static_cast<double>(receptive_field()) / rate_hz};
}

}  // namespace freetalk::speech
