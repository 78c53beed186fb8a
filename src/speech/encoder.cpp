#include "freetalk/speech/encoder.h"

#include <torch/torch.h>

#include "freetalk/core/error.h"
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

at::Tensor SpeechEncoderImpl::extract_features(const at::Tensor& wave,
                                               const std::optional<at::Tensor>& mask) {
  return feature_extractor_->forward(wave, check_wave(wave, mask));
}

at::Tensor SpeechEncoderImpl::encode_features(const at::Tensor& features,
                                              const std::optional<at::Tensor>& valid_frames) {
  FREETALK_CHECK(features.dim() == 3 && features.size(2) == options_.conv_dim.back(),
                 "features have shape ", features.sizes(), ": expected (B, S', ",
                 options_.conv_dim.back(), ")");
  FREETALK_CHECK(!valid_frames || valid_frames->sizes() == at::IntArrayRef({features.size(0)}),
                 "valid_frames must have shape (B,) = (", features.size(0), ",)");
  return encoder_->forward(feature_projection_->forward(features), valid_frames);
}

at::Tensor SpeechEncoderImpl::forward(const at::Tensor& wave,
                                      const std::optional<at::Tensor>& mask) {
  auto valid = check_wave(wave, mask);
  const auto features = feature_extractor_->forward(wave, valid);
  if (valid) {  // samples -> frames, layer after layer
    for (size_t i = 0; i < options_.conv_dim.size(); ++i) {
      valid = at::floor_divide(*valid - options_.conv_kernel[i], options_.conv_stride[i]) + 1;
    }
  }
  return encode_features(features, valid);
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
