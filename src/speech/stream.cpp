#include "freetalk/speech/stream.h"

#include <torch/torch.h>

#include "freetalk/core/error.h"
#include "pieces.h"

namespace freetalk::speech {

EncodeOptions stream_options() {
  EncodeOptions options;
  options.window_s = 4.8;
  options.context_s = 4.0;
  options.lookahead_s = 0.4;
  options.fade_s = 0.1;
  options.streamable = true;
  return options;
}

SpeechStream::SpeechStream(SpeechEncoder encoder, std::optional<double> fps, EncodeOptions options,
                           std::optional<at::Tensor> layer_weights)
    : encoder_(std::move(encoder)),
      fps_(fps),
      options_(std::move(options)),
      layer_weights_(std::move(layer_weights)) {
  if (fps_) {
    num_motion_frames(1, *fps_);  // checks the rate
  }
  options_.streamable = true;
  pieces_ = std::make_unique<PieceEncoder>(encoder_, fps_, options_, layer_weights_);
}

SpeechStream::~SpeechStream() = default;
SpeechStream::SpeechStream(SpeechStream&&) noexcept = default;

at::Tensor SpeechStream::push(const at::Tensor& samples) {
  FREETALK_CHECK(samples.dim() == 1 && samples.is_floating_point(), "samples have shape ",
                 samples.sizes(), " and type ", samples.scalar_type(), ": expected (n,) float");
  num_samples_ += samples.size(0);
  return pieces_->push(samples);
}

at::Tensor SpeechStream::finish() {
  auto rest = at::empty({0, encoder_->options().hidden_size}, pieces_->result_options());
  if (num_samples_ > 0) {
    rest = pieces_->finish();
  }
  num_samples_ = 0;
  pieces_ = std::make_unique<PieceEncoder>(encoder_, fps_, options_, layer_weights_);
  return rest;
}

double SpeechStream::latency_s() const { return pieces_->latency_s(); }

int64_t SpeechStream::num_held() const { return pieces_->num_held(); }

}  // namespace freetalk::speech
