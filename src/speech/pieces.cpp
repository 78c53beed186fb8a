#include "pieces.h"

#include <torch/torch.h>

#include <algorithm>
#include <cmath>

#include "core/autocast.h"
#include "freetalk/core/error.h"

namespace freetalk::speech {
namespace {

const double kRate = static_cast<double>(kSampleRateHz);

}  // namespace

at::Tensor interpolate_frames(const at::Tensor& features, at::Tensor positions) {
  const int64_t last = features.size(-2) - 1;
  positions = positions.clamp(0.0, static_cast<double>(last));
  const auto lower = positions.floor();
  const auto weight = (positions - lower).to(features.options()).unsqueeze(1);  // (T, 1)
  const auto index = lower.to(at::kLong);
  const auto left = features.index_select(-2, index.to(features.device()));
  const auto right = features.index_select(-2, (index + 1).clamp_max(last).to(features.device()));
  return left + weight * (right - left);
}

at::Tensor mix_states(const std::vector<at::Tensor>& states, const at::Tensor& weights) {
  FREETALK_CHECK(weights.sizes() == at::IntArrayRef({static_cast<int64_t>(states.size())}),
                 "layer_weights have shape ", weights.sizes(), ": expected (", states.size(),
                 ",), one a hidden state");
  auto sum = states[0] * weights[0].to(states[0].device());
  for (size_t i = 1; i < states.size(); ++i) {
    sum = sum + states[i] * weights[static_cast<int64_t>(i)].to(states[i].device());
  }
  return sum;
}

EvaluationScope::EvaluationScope(torch::nn::Module& module) : module_(module) {
  const auto parts = module_.modules();  // parents come first
  if (std::none_of(parts.begin(), parts.end(), [](const auto& m) { return m->is_training(); })) {
    return;
  }
  for (const auto& part : parts) was_training_.push_back(part->is_training());
  module_.eval();
}

EvaluationScope::~EvaluationScope() {
  if (was_training_.empty()) return;
  const auto parts = module_.modules();
  for (size_t i = 0; i < parts.size(); ++i) {
    if (parts[i]->is_training() != was_training_[i]) parts[i]->train(was_training_[i]);
  }
}

PieceEncoder::PieceEncoder(SpeechEncoder encoder, std::optional<double> fps,
                           const EncodeOptions& options,
                           const std::optional<at::Tensor>& layer_weights)
    : encoder_(std::move(encoder)),
      fps_(fps),
      options_(options),
      layer_weights_(layer_weights),
      output_(fps ? FrameTiming{*fps, 0.0} : encoder_->timing()),
      statistics_(
          encoder_->options().feat_extract_norm == "group" ? encoder_->options().conv_kernel[0] : 0,
          encoder_->options().conv_stride[0]),
      buffer_(at::empty({0}, at::kFloat)) {
  options_.check();
  const double frame = static_cast<double>(encoder_->frame_stride());
  const auto on_grid = [&](double seconds) {  // pieces begin where frames of a whole clip begin
    return static_cast<int64_t>(std::ceil(seconds * kRate / frame - 1e-9) * frame);
  };
  const double lookahead_s = options_.lookahead_s > 0.0 ? options_.lookahead_s : options_.context_s;
  const double shorter = std::min(lookahead_s, options_.context_s);
  context_ = on_grid(options_.context_s);
  lookahead_ = on_grid(lookahead_s);
  fade_ = (options_.fade_s > 0.0 ? options_.fade_s : 0.5 * shorter) * kRate;
  hop_ = on_grid(options_.window_s) - context_ - lookahead_;
  const double margin = 0.5 * fade_ + static_cast<double>(encoder_->receptive_field());
  FREETALK_CHECK(shorter * kRate >= margin && static_cast<double>(hop_) >= fade_ + frame,
                 "window_s ", options_.window_s, ", context_s ", options_.context_s,
                 ", lookahead_s ", lookahead_s, " and fade_s ", fade_ / kRate,
                 " do not fit: context and lookahead must exceed half of fade_s by the encoder's ",
                 encoder_->receptive_field(), " samples, and window_s their sum by fade_s");
}

at::TensorOptions PieceEncoder::result_options() const {
  return encoder_->parameters().front().options().dtype(at::kFloat).requires_grad(false);
}

int64_t PieceEncoder::num_frames(int64_t num_samples) const {
  return fps_ ? num_motion_frames(num_samples, *fps_)
              : std::max<int64_t>(1, encoder_->num_frames(num_samples));
}

double PieceEncoder::latency_s() const {
  return (static_cast<double>(hop_ + lookahead_) + 0.5 * fade_) / kRate;
}

void PieceEncoder::set_clip(const at::Tensor& samples) {
  constexpr int64_t kBlock = 1 << 20;
  for (int64_t first = 0; first < samples.size(0); first += kBlock) {
    const int64_t count = std::min(kBlock, samples.size(0) - first);
    statistics_.add(samples.narrow(0, first, count).to(at::kCPU, at::kFloat));
  }
  whole_clip_ = true;
  if (samples.size(0) <= hop_ + context_ + lookahead_) {
    hop_ = samples.size(0) + 1;
  }
}

int64_t PieceEncoder::frames_before(double samples) const {
  const double frames = (samples / kRate - output_.offset_s) * output_.rate_hz;
  return std::max<int64_t>(0, static_cast<int64_t>(std::ceil(frames - 1e-9)));
}

at::Tensor PieceEncoder::push(const at::Tensor& samples) {
  buffer_ = at::cat({buffer_, samples.detach().to(at::kCPU, at::kFloat)});
  heard_ += samples.size(0);
  std::vector<at::Tensor> ready;
  while (heard_ >= (piece_ + 1) * hop_ + lookahead_) {
    ready.push_back(run_piece((piece_ + 1) * hop_ + lookahead_, /*last=*/false));
  }
  if (ready.empty()) {
    return at::empty({0, encoder_->options().hidden_size}, result_options());
  }
  return at::cat(ready);
}

at::Tensor PieceEncoder::finish() {
  if (heard_ > last_end_) {
    return run_piece(heard_, /*last=*/true);
  }
  return tail_.narrow(0, 0,
                      std::clamp<int64_t>(num_frames(heard_) - next_frame_, 0, tail_.size(0)));
}

at::Tensor PieceEncoder::run_piece(int64_t end, bool last) {
  const int64_t border = piece_ * hop_;
  const int64_t start = std::max<int64_t>(0, border - context_);
  if (!whole_clip_) {
    statistics_.add(buffer_.slice(0, counted_ - buffer_start_, end - buffer_start_));
    counted_ = end;
  }
  const auto wave =
      statistics_.normalize(buffer_.slice(0, start - buffer_start_, end - buffer_start_));
  const int64_t stop = last ? num_frames(heard_) : frames_before(static_cast<double>(end));
  auto values = encode_frames(wave, start, next_frame_, stop);
  if (piece_ > 0) {
    values = blend_with_tail(values, static_cast<double>(border));
  }
  ++piece_;
  last_end_ = end;
  const double until = static_cast<double>(piece_ * hop_) - 0.5 * fade_;
  const int64_t ready =
      last ? values.size(0)
           : std::clamp<int64_t>(frames_before(until) - next_frame_, 0, values.size(0));
  tail_ = values.slice(0, ready).clone();
  next_frame_ += ready;
  forget();
  return values.narrow(0, 0, ready);
}

at::Tensor PieceEncoder::blend_with_tail(const at::Tensor& values, double border) const {
  const int64_t count = std::clamp<int64_t>(frames_before(border + 0.5 * fade_) - next_frame_, 0,
                                            std::min(values.size(0), tail_.size(0)));
  const auto frames = at::arange(next_frame_, next_frame_ + count, at::kDouble);
  const auto seconds = output_.offset_s + frames / output_.rate_hz;
  const auto weight = ((seconds * kRate - border) / fade_ + 0.5)
                          .clamp(0.0, 1.0)
                          .to(values.options())
                          .unsqueeze(1);  // (n, 1)
  const auto before = tail_.narrow(0, 0, count);
  values.narrow(0, 0, count).sub_(before).mul_(weight).add_(before);
  return values;
}

void PieceEncoder::forget() {
  const int64_t keep = std::max<int64_t>(0, piece_ * hop_ - context_);
  const int64_t from = std::clamp(keep, buffer_start_, heard_);
  buffer_ = buffer_.slice(0, from - buffer_start_).clone();
  buffer_start_ = from;
}

at::Tensor PieceEncoder::encode_layers(const at::Tensor& features) {
  if (!layer_weights_) {
    return encoder_->encode(features, std::nullopt, options_.layer, nullptr).squeeze(0);
  }
  return mix_states(encoder_->encode_states(features), *layer_weights_).squeeze(0);
}

at::Tensor PieceEncoder::encode_frames(const at::Tensor& wave, int64_t start, int64_t first,
                                       int64_t stop) {
  const torch::NoGradGuard no_grad;
  const EvaluationScope evaluation(*encoder_);
  const auto parameter = encoder_->parameters().front();
  const core::Bfloat16Scope bfloat16(parameter.device().type(), options_.precision == "bfloat16");
  const int64_t missing = std::max<int64_t>(0, encoder_->receptive_field() - wave.size(0));
  const auto piece = at::constant_pad_nd(wave, {0, missing});
  auto moments = statistics_.moments();
  if (!moments.mean.defined() && encoder_->options().feat_extract_norm == "group") {
    moments = window_moments(piece, encoder_->options().conv_kernel[0],
                             encoder_->options().conv_stride[0]);
  }
  auto features = encoder_->extract(piece.unsqueeze(0).to(parameter.options().requires_grad(false)),
                                    std::nullopt, moments.mean.defined() ? &moments : nullptr);
  const auto positions = [&](int64_t from, int64_t to) {
    const auto seconds = output_.offset_s + at::arange(from, to, at::kDouble) / output_.rate_hz;
    const auto timing = encoder_->timing();
    return (seconds - static_cast<double>(start) / kRate - timing.offset_s) * timing.rate_hz;
  };
  if (fps_ && options_.resample == "conv") {
    const int64_t begin = std::min(first, frames_before(static_cast<double>(start)));
    features = interpolate_frames(features, positions(begin, std::max(stop, begin + 1)));
    return encode_layers(features).slice(0, first - begin, stop - begin).to(at::kFloat);
  }
  return interpolate_frames(encode_layers(features).to(at::kFloat), positions(first, stop));
}

}  // namespace freetalk::speech
