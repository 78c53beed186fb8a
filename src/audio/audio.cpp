#include "freetalk/audio/audio.h"

#include <sndfile.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <memory>
#include <optional>
#include <ostream>
#include <string>
#include <string_view>

#include "core/file.h"
#include "freetalk/core/error.h"
#include "resampler.h"

namespace freetalk::audio {
namespace {

struct CloseFile {
  void operator()(SNDFILE* file) const { sf_close(file); }
};
using File = std::unique_ptr<SNDFILE, CloseFile>;

constexpr int64_t kBlockSamples = 65536;  // over all channels
constexpr double kMaxMagnitude = 1e10;    // above any integer scale; also false for NaN
const char* const kTooLong = ": is longer than 6 hours; split it into shorter files";
const char* const kConvert =
    "; convert it to WAV or FLAC, for example with: ffmpeg -i INPUT output.wav";

File open_for_reading(const std::filesystem::path& path, SF_INFO& info) {
  const std::string name = path.string();
  std::error_code code;
  const auto status = std::filesystem::status(path, code);
  FREETALK_RUNTIME_CHECK(std::filesystem::exists(status), name,
                         ": there is no such audio file; check the path");
  FREETALK_RUNTIME_CHECK(!std::filesystem::is_directory(status), name,
                         ": is a folder, not an audio file; name one file in it");
  FREETALK_RUNTIME_CHECK(std::filesystem::is_regular_file(status), name,
                         ": is not a regular file; write the sound to a file first");
  const auto size = std::filesystem::file_size(path, code);
  FREETALK_RUNTIME_CHECK(!code, name, ": cannot be read (", code.message(), ")");
  FREETALK_RUNTIME_CHECK(size > 0, name, ": is an empty file; record or copy it again");
  File file(sf_open(name.c_str(), SFM_READ, &info));
  FREETALK_RUNTIME_CHECK(file != nullptr, name, ": is not an audio file that can be read (",
                         sf_strerror(nullptr), ")", kConvert);
  FREETALK_RUNTIME_CHECK(info.channels > 0, name, ": has no channels", kConvert);
  FREETALK_RUNTIME_CHECK(info.samplerate >= kMinSampleRateHz && info.samplerate <= kMaxSampleRateHz,
                         name, ": claims a sample rate of ", info.samplerate,
                         " Hz, which must be between ", kMinSampleRateHz, " and ", kMaxSampleRateHz,
                         kConvert);
  return file;
}

/// Bytes of sound that a header promises and that there are.
struct DataSize {
  int64_t promised = 0, present = 0;
};

/// Reads "data : 3200 (should be 1600)" at the start of `text`, as libsndfile's log words it.
std::optional<DataSize> parse_shortened(std::string_view text) {
  const auto skip = [&](std::string_view characters) {
    const auto next = text.find_first_not_of(characters);
    text.remove_prefix(std::min(next, text.size()));
  };
  const auto number = [&](int64_t& value) {
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    text.remove_prefix(static_cast<size_t>(end - text.data()));
    return error == std::errc();
  };
  constexpr std::string_view kCorrection = "(should be ";
  DataSize size;
  text.remove_prefix(4);
  skip(" :");
  if (!number(size.promised)) {
    return std::nullopt;
  }
  skip(" ");
  if (text.substr(0, kCorrection.size()) != kCorrection) {
    return std::nullopt;
  }
  text.remove_prefix(kCorrection.size());
  return number(size.present) ? std::optional(size) : std::nullopt;
}

/// What libsndfile shortened, if it did: it does so in silence and only notes it in its log.
std::optional<DataSize> shortened_data(SNDFILE* file) {
  std::string log(16384, '\0');
  const int used = sf_command(file, SFC_GET_LOG_INFO, log.data(), static_cast<int>(log.size()));
  log.resize(static_cast<size_t>(std::clamp(used, 0, static_cast<int>(log.size()))));
  for (const std::string_view chunk : {"data", "SSND"}) {
    for (auto at = log.find(chunk); at != std::string::npos; at = log.find(chunk, at + 1)) {
      if (const auto size = parse_shortened(std::string_view(log).substr(at))) {
        return size;
      }
    }
  }
  return std::nullopt;
}

/// Whether a WAV or AIFF header promises much more data than the file holds. Writers that stream
/// leave a size of about 2^31 or 2^32: no promise.
bool header_promises_more(SNDFILE* file, const SF_INFO& info) {
  constexpr int64_t kStreaming = 0x7FFF0000;
  const auto size = shortened_data(file);
  if (!size || size->promised >= kStreaming) {
    return false;
  }
  const double bytes_per_s =
      info.frames > 0
          ? static_cast<double>(size->present) * info.samplerate / static_cast<double>(info.frames)
          : 1.0;
  const double missing = static_cast<double>(size->promised) - static_cast<double>(size->present);
  return missing > 0.02 * bytes_per_s;
}

/// Reads the frames of a file block by block and averages its channels.
class MonoReader {
 public:
  MonoReader(std::string name, File file, const SF_INFO& info)
      : name_(std::move(name)),
        file_(std::move(file)),
        info_(info),
        block_(static_cast<size_t>(frames_per_block() * info.channels)),
        mono_(static_cast<size_t>(frames_per_block())) {}

  /// The next samples in `mono()`; 0 at the end.
  int64_t read() {
    const int64_t count = sf_readf_float(file_.get(), block_.data(), frames_per_block());
    const auto channels = static_cast<size_t>(info_.channels);
    for (int64_t i = 0; i < count; ++i) {
      const float* frame = block_.data() + static_cast<size_t>(i) * channels;
      double sum = 0.0;
      for (size_t c = 0; c < channels; ++c) {
        sum += frame[c];
      }
      FREETALK_RUNTIME_CHECK(std::abs(sum) < kMaxMagnitude, name_, ": the sample at ",
                             static_cast<double>(num_read_ + i) / info_.samplerate, " s is ", sum,
                             "; export the sound again");
      mono_[static_cast<size_t>(i)] = static_cast<float>(sum / info_.channels);
    }
    num_read_ += std::max<int64_t>(0, count);
    FREETALK_RUNTIME_CHECK(static_cast<double>(num_read_) <= kMaxDurationS * info_.samplerate,
                           name_, kTooLong);
    return std::max<int64_t>(0, count);
  }

  const float* mono() const { return mono_.data(); }

  void check_complete() const {
    FREETALK_RUNTIME_CHECK(num_read_ > 0, name_, ": holds no samples; record or copy it again");
    const bool mpeg = (info_.format & SF_FORMAT_TYPEMASK) == SF_FORMAT_MPEG;  // length is a guess
    const auto tolerated = static_cast<int64_t>(0.02 * info_.samplerate);
    const bool known = info_.frames < SF_COUNT_MAX / 2;
    FREETALK_RUNTIME_CHECK(mpeg || !known || info_.frames - num_read_ <= tolerated, name_,
                           ": is truncated: its header promises ",
                           static_cast<double>(info_.frames) / info_.samplerate, " s but it holds ",
                           static_cast<double>(num_read_) / info_.samplerate,
                           " s; copy or export it again");
    FREETALK_RUNTIME_CHECK(!header_promises_more(file_.get(), info_), name_,
                           ": is truncated: its header promises more than the ",
                           static_cast<double>(num_read_) / info_.samplerate,
                           " s that it holds; copy or export it again");
  }

 private:
  int64_t frames_per_block() const { return std::max<int64_t>(1, kBlockSamples / info_.channels); }

  std::string name_;
  File file_;
  SF_INFO info_;
  std::vector<float> block_, mono_;
  int64_t num_read_ = 0;
};

/// A stream for libsndfile to write to. Nothing may be thrown through its C frames: what fails
/// shows in the stream's state.
struct StreamFile {
  static std::ostream& stream(void* self) { return *static_cast<std::ostream*>(self); }

  static sf_count_t length(void* self) noexcept {
    const auto position = stream(self).tellp();
    stream(self).seekp(0, std::ios::end);
    const auto end = stream(self).tellp();
    stream(self).seekp(position);
    return end;
  }
  static sf_count_t seek(sf_count_t offset, int whence, void* self) noexcept {
    stream(self).seekp(offset, whence == SEEK_SET   ? std::ios::beg
                               : whence == SEEK_CUR ? std::ios::cur
                                                    : std::ios::end);
    return stream(self).tellp();
  }
  static sf_count_t read(void*, sf_count_t, void*) noexcept { return 0; }  // only written to
  static sf_count_t write(const void* source, sf_count_t count, void* self) noexcept {
    return stream(self).write(static_cast<const char*>(source), count) ? count : 0;
  }
  static sf_count_t tell(void* self) noexcept { return stream(self).tellp(); }
};

}  // namespace

void Audio::check() const {
  FREETALK_CHECK(sample_rate_hz >= kMinSampleRateHz && sample_rate_hz <= kMaxSampleRateHz,
                 "sample_rate_hz is ", sample_rate_hz, ": it must be between ", kMinSampleRateHz,
                 " and ", kMaxSampleRateHz);
  const auto bad = std::find_if_not(samples.begin(), samples.end(),
                                    [](float value) { return std::isfinite(value); });
  FREETALK_CHECK(bad == samples.end(), "sample ", bad - samples.begin(),
                 " of the audio is not finite");
}

Audio load_audio(const std::filesystem::path& path, int64_t sample_rate_hz) {
  SF_INFO info{};
  auto file = open_for_reading(path, info);
  Resampler resampler(info.samplerate, sample_rate_hz);
  // A header may lie: room is made at once only for what the file's size can hold.
  const bool plausible =
      info.frames > 0 && static_cast<uintmax_t>(info.frames) <= std::filesystem::file_size(path);
  MonoReader reader(path.string(), std::move(file), info);
  Audio audio;
  audio.sample_rate_hz = sample_rate_hz;
  if (plausible) {
    FREETALK_RUNTIME_CHECK(static_cast<double>(info.frames) <= kMaxDurationS * info.samplerate,
                           path.string(), kTooLong);
    audio.samples.reserve(
        static_cast<size_t>(resampled_size(info.frames, info.samplerate, sample_rate_hz)));
  }
  while (const int64_t count = reader.read()) {
    resampler.push(reader.mono(), count, audio.samples);
  }
  reader.check_complete();
  resampler.finish(audio.samples);
  return audio;
}

void save_wav(const std::filesystem::path& path, const Audio& audio, int bits_per_sample) {
  audio.check();
  FREETALK_CHECK(!audio.samples.empty(), "there are no samples to write to ", path.string());
  FREETALK_CHECK(bits_per_sample == 16 || bits_per_sample == 24 || bits_per_sample == 32,
                 "bits_per_sample is ", bits_per_sample, ": use 16, 24 or 32 (float)");
  SF_INFO info{};
  info.samplerate = static_cast<int>(audio.sample_rate_hz);
  info.channels = 1;
  info.format = SF_FORMAT_WAV | (bits_per_sample == 16   ? SF_FORMAT_PCM_16
                                 : bits_per_sample == 24 ? SF_FORMAT_PCM_24
                                                         : SF_FORMAT_FLOAT);
  SF_VIRTUAL_IO io{StreamFile::length, StreamFile::seek, StreamFile::read, StreamFile::write,
                   StreamFile::tell};
  core::write_file_atomic(path, [&](std::ostream& stream) {
    File file(sf_open_virtual(&io, SFM_WRITE, &info, &stream));
    FREETALK_RUNTIME_CHECK(file != nullptr, path.string(), ": ", sf_strerror(nullptr));
    sf_command(file.get(), SFC_SET_CLIPPING, nullptr, SF_TRUE);
    const auto count = static_cast<sf_count_t>(audio.samples.size());
    const auto written = sf_writef_float(file.get(), audio.samples.data(), count);
    FREETALK_RUNTIME_CHECK(written == count, path.string(), ": ", sf_strerror(file.get()));
  });  // the end of `file` completes the header
}

}  // namespace freetalk::audio
