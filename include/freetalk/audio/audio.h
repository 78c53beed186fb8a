// The audio door: any file that libsndfile reads becomes mono float samples at the rate that is
// asked for.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

namespace freetalk::audio {

/// Mono sound.
struct Audio {
  std::vector<float> samples;      // nominally in [-1, 1]
  int64_t sample_rate_hz = 16000;  // in [kMinSampleRateHz, kMaxSampleRateHz]

  double duration_s() const {
    return static_cast<double>(samples.size()) / static_cast<double>(sample_rate_hz);
  }
  /// @throws std::invalid_argument for a sample that is not finite or a sample rate out of range
  void check() const;
};

inline constexpr int64_t kMinSampleRateHz = 1000;
inline constexpr int64_t kMaxSampleRateHz = 768000;
inline constexpr double kMaxDurationS = 6.0 * 3600.0;  // longer files are refused by load_audio

/// Samples of a clip at another rate: n * to / from, rounded to the nearest integer, at least 1.
int64_t resampled_size(int64_t num_samples, int64_t from_hz, int64_t to_hz);

/// Reads WAV, FLAC, OGG, AIFF, MP3 and whatever else libsndfile knows, block by block; channels are
/// averaged, then resampled with libsamplerate's best sinc converter. A file with n samples a
/// channel gives resampled_size(n, rate of the file, sample_rate_hz) samples, that is
/// max(1, round(n * sample_rate_hz / rate)); n is what the decoder delivers: for WAV, FLAC, AIFF
/// and OGG the length that was recorded, for MP3 without a gapless tag whole MPEG frames.
/// @param sample_rate_hz rate of the result
/// @throws std::runtime_error in one sentence naming the file and what to do: missing, a folder,
/// empty, not audio,
///   truncated, samples that are not finite, an absurd sample rate, longer than kMaxDurationS
Audio load_audio(const std::filesystem::path& path, int64_t sample_rate_hz = 16000);

/// The same sound at another rate (libsamplerate, best sinc).
Audio resample(const Audio& audio, int64_t sample_rate_hz);

/// Writes a WAV atomically; samples beyond [-1, 1] are clipped unless float.
/// @param bits_per_sample 16, 24 or 32 (float)
/// @throws std::invalid_argument for audio that holds nothing or does not pass check()
/// @throws std::runtime_error naming the file when it can't be written
void save_wav(const std::filesystem::path& path, const Audio& audio, int bits_per_sample = 16);

}  // namespace freetalk::audio
