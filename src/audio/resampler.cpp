#include "resampler.h"

#include <algorithm>
#include <cmath>

#include "freetalk/audio/audio.h"
#include "freetalk/core/error.h"

namespace freetalk::audio {
namespace {

constexpr int64_t kBlock = 16384;

void check_rate(int64_t rate_hz) {
  FREETALK_CHECK(rate_hz >= kMinSampleRateHz && rate_hz <= kMaxSampleRateHz, "sample_rate_hz is ",
                 rate_hz, ": it must be between ", kMinSampleRateHz, " and ", kMaxSampleRateHz);
}

}  // namespace

int64_t resampled_size(int64_t num_samples, int64_t from_hz, int64_t to_hz) {
  if (num_samples == 0) {
    return 0;
  }
  const double exact =
      static_cast<double>(num_samples) * static_cast<double>(to_hz) / static_cast<double>(from_hz);
  return std::max<int64_t>(1, std::llround(exact));
}

Resampler::Resampler(int64_t from_hz, int64_t to_hz) : from_hz_(from_hz), to_hz_(to_hz) {
  check_rate(from_hz);
  check_rate(to_hz);
  if (from_hz == to_hz) {
    return;
  }
  FREETALK_CHECK(from_hz <= 256 * to_hz && to_hz <= 256 * from_hz, "cannot resample from ", from_hz,
                 " Hz to ", to_hz, " Hz: the rates may differ by a factor of 256 at most");
  int error = 0;
  state_.reset(src_new(SRC_SINC_BEST_QUALITY, 1, &error));
  FREETALK_RUNTIME_CHECK(state_ != nullptr, "libsamplerate: ", src_strerror(error));
  block_.resize(kBlock);
}

void Resampler::push(const float* samples, int64_t count, std::vector<float>& result) {
  num_pushed_ += count;
  if (!state_) {
    result.insert(result.end(), samples, samples + count);
    return;
  }
  process(samples, count, /*last=*/false, result);
}

void Resampler::finish(std::vector<float>& result) {
  if (state_) {
    process(nullptr, 0, /*last=*/true, result);
  }
  result.resize(static_cast<size_t>(resampled_size(num_pushed_, from_hz_, to_hz_)), 0.0F);
}

void Resampler::process(const float* samples, int64_t count, bool last,
                        std::vector<float>& result) {
  static const float kNothing = 0.0F;
  SRC_DATA data{};
  data.data_in = samples != nullptr ? samples : &kNothing;
  data.input_frames = static_cast<long>(count);
  data.data_out = block_.data();
  data.output_frames = static_cast<long>(block_.size());
  data.end_of_input = last ? 1 : 0;
  data.src_ratio = static_cast<double>(to_hz_) / static_cast<double>(from_hz_);
  do {
    const int error = src_process(state_.get(), &data);
    FREETALK_RUNTIME_CHECK(error == 0, "libsamplerate: ", src_strerror(error));
    result.insert(result.end(), block_.begin(), block_.begin() + data.output_frames_gen);
    data.data_in += data.input_frames_used;
    data.input_frames -= data.input_frames_used;
  } while (data.input_frames > 0 || data.output_frames_gen > 0);
}

Audio resample(const Audio& audio, int64_t sample_rate_hz) {
  audio.check();
  Audio result;
  result.sample_rate_hz = sample_rate_hz;
  Resampler resampler(audio.sample_rate_hz, sample_rate_hz);
  resampler.push(audio.samples.data(), static_cast<int64_t>(audio.samples.size()), result.samples);
  resampler.finish(result.samples);
  return result;
}

}  // namespace freetalk::audio
