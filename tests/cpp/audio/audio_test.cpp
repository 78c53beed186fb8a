#include "freetalk/audio/audio.h"

#include <gtest/gtest.h>

#include <sys/resource.h>
#include <unistd.h>

#include <cmath>
#include <csignal>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <limits>
#include <new>
#include <numbers>

#include "core/file.h"

namespace {

/// Larger allocations of this thread fail.
thread_local size_t allocation_limit = SIZE_MAX;

}  // namespace

void* operator new(size_t size) {
  void* const memory = size <= allocation_limit ? std::malloc(size) : nullptr;
  if (memory == nullptr) throw std::bad_alloc();
  return memory;
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, size_t) noexcept { std::free(memory); }

namespace freetalk::audio {
namespace {

Audio sine(double frequency_hz, int64_t sample_rate_hz, int64_t count) {
  Audio audio;
  audio.sample_rate_hz = sample_rate_hz;
  audio.samples.resize(static_cast<size_t>(count));
  for (int64_t i = 0; i < count; ++i) {
    const double t = static_cast<double>(i) / static_cast<double>(sample_rate_hz);
    audio.samples[static_cast<size_t>(i)] =
        static_cast<float>(0.5 * std::sin(2.0 * std::numbers::pi * frequency_hz * t));
  }
  return audio;
}

/// Largest difference, 20 ms at both ends left out.
double max_difference(const Audio& a, const Audio& b) {
  const auto edge = static_cast<size_t>(a.sample_rate_hz / 50);
  double worst = 0.0;
  for (size_t i = edge; i + edge < std::min(a.samples.size(), b.samples.size()); ++i) {
    worst = std::max(worst, static_cast<double>(std::abs(a.samples[i] - b.samples[i])));
  }
  return worst;
}

class AudioFile : public ::testing::Test {
 protected:
  void SetUp() override {
    dir_ =
        std::filesystem::temp_directory_path() / ("freetalk_audio_" + std::to_string(::getpid()));
    std::filesystem::create_directories(dir_);
    path_ = dir_ / "sound.wav";
  }
  void TearDown() override { std::filesystem::remove_all(dir_); }

  void write(const std::string& bytes) { core::write_file_atomic(path_, bytes); }

  /// The message of load_audio; checks that it names the file.
  std::string load_error(const std::filesystem::path& path) {
    try {
      load_audio(path);
    } catch (const std::runtime_error& error) {
      EXPECT_NE(std::string(error.what()).find(path.string()), std::string::npos);
      return error.what();
    }
    return "";
  }
  std::string load_error() { return load_error(path_); }

  std::filesystem::path dir_, path_;
};

bool mentions(const std::string& text, const char* word) {
  return text.find(word) != std::string::npos;
}

TEST(Resample, KeepsASineInPlaceAtEveryRate) {
  for (const int64_t from : {8000, 11025, 22050, 44100, 48000, 96000}) {
    const auto result = resample(sine(440.0, from, from), 16000);
    EXPECT_EQ(result.samples.size(), 16000U);
    EXPECT_LT(max_difference(result, sine(440.0, 16000, 16000)), 1e-3) << from;
  }
}

TEST(Resample, RemovesWhatTheNewRateCannotHold) {
  const auto result = resample(sine(11000.0, 48000, 48000), 16000);
  double peak = 0.0;
  for (size_t i = 320; i + 320 < result.samples.size(); ++i) {
    peak = std::max(peak, static_cast<double>(std::abs(result.samples[i])));
  }
  EXPECT_LT(peak, 1e-3);
}

TEST(Resample, LengthIsRounded) {
  EXPECT_EQ(resampled_size(44100, 44100, 16000), 16000);
  EXPECT_EQ(resampled_size(1, 48000, 16000), 1);
  EXPECT_EQ(resampled_size(0, 48000, 16000), 0);
  for (const int64_t count : {1, 2, 100, 44099, 65537, 200001}) {
    const auto result = resample(sine(100.0, 44100, count), 16000);
    EXPECT_EQ(static_cast<int64_t>(result.samples.size()), resampled_size(count, 44100, 16000));
  }
}

TEST(Resample, RefusesAbsurdRates) {
  const auto audio = sine(100.0, 16000, 1000);
  EXPECT_THROW(resample(audio, 0), std::invalid_argument);
  EXPECT_THROW(resample(audio, 10), std::invalid_argument);
  EXPECT_THROW(resample(audio, 10'000'000), std::invalid_argument);
}

TEST_F(AudioFile, RoundTripsThroughWav) {
  const auto audio = sine(300.0, 16000, 8000);
  for (const auto& [bits, tolerance] :
       {std::pair{16, 2.0 / 32768}, std::pair{24, 2.0 / 8388608}, std::pair{32, 0.0}}) {
    save_wav(path_, audio, bits);
    const auto loaded = load_audio(path_);
    EXPECT_EQ(loaded.samples.size(), audio.samples.size());
    EXPECT_LE(max_difference(loaded, audio), tolerance);
    EXPECT_DOUBLE_EQ(loaded.duration_s(), 0.5);
  }
}

TEST_F(AudioFile, LoadsInBlocksWhatResampleMakesAtOnce) {
  const auto audio = sine(300.0, 44100, 300001);
  save_wav(path_, audio, 32);
  const auto loaded = load_audio(path_, 16000);
  const auto expected = resample(audio, 16000);
  EXPECT_EQ(loaded.samples.size(), expected.samples.size());
  EXPECT_LT(max_difference(loaded, expected), 1e-6);
}

TEST_F(AudioFile, NamesWhatIsWrong) {
  EXPECT_TRUE(mentions(load_error(), "no such"));
  EXPECT_TRUE(mentions(load_error(dir_), "folder"));
  write("");
  EXPECT_TRUE(mentions(load_error(), "empty"));
  write("this is a letter, not a recording; it goes on for a while");
  EXPECT_TRUE(mentions(load_error(), "not an audio file"));
}

TEST_F(AudioFile, RefusesTruncatedFiles) {
  save_wav(path_, sine(300.0, 16000, 16000));
  const auto bytes = core::read_text(path_);
  write(bytes.substr(0, bytes.size() / 2));
  EXPECT_TRUE(mentions(load_error(), "truncated"));
  write(bytes.substr(0, 44));
  EXPECT_FALSE(load_error().empty());
}

TEST_F(AudioFile, ReadsStreamedWavsWithoutALength) {
  save_wav(path_, sine(300.0, 16000, 16000));
  auto bytes = core::read_text(path_);
  const auto data = bytes.find("data");
  std::memset(bytes.data() + data + 4, 0xFF, 4);
  std::memset(bytes.data() + 4, 0xFF, 4);
  write(bytes);
  EXPECT_EQ(load_audio(path_).samples.size(), 16000U);
}

TEST_F(AudioFile, RefusesSamplesThatAreNotFiniteOrSensible) {
  for (const float bad : {std::nanf(""), std::numeric_limits<float>::infinity(), -1e30F}) {
    save_wav(path_, sine(300.0, 16000, 16000), 32);
    auto bytes = core::read_text(path_);
    std::memcpy(bytes.data() + bytes.size() - 16000, &bad, sizeof bad);
    write(bytes);
    EXPECT_TRUE(mentions(load_error(), "the sample at"));
  }
}

TEST_F(AudioFile, RefusesAbsurdSampleRates) {
  for (const uint32_t rate : {0U, 7U, 100'000'000U}) {
    save_wav(path_, sine(300.0, 16000, 1000));
    auto bytes = core::read_text(path_);
    std::memcpy(bytes.data() + 24, &rate, sizeof rate);
    write(bytes);
    EXPECT_FALSE(load_error().empty()) << rate;
  }
}

/// A WAV of silence whose sound is a hole in the file.
void write_silence(const std::filesystem::path& path, uint32_t rate_hz, uint32_t count) {
  std::string header = "RIFF....WAVEfmt ";
  const auto add = [&](uint32_t value, int bytes) {
    for (int i = 0; i < bytes; ++i) {
      header += static_cast<char>(value >> (8 * i));
    }
  };
  add(16, 4);
  add(1, 2);
  add(1, 2);
  add(rate_hz, 4);
  add(rate_hz * 2, 4);
  add(2, 2);
  add(16, 2);
  header += "data";
  add(count * 2, 4);
  const uint32_t riff = count * 2 + 36;
  std::memcpy(header.data() + 4, &riff, sizeof riff);
  core::write_file_atomic(path, header);
  std::filesystem::resize_file(path, header.size() + size_t{count} * 2);
}

TEST_F(AudioFile, ThreeHoursLoadAndSevenAreRefused) {
  write_silence(path_, 1000, 3 * 3600 * 1000);
  EXPECT_EQ(load_audio(path_, 1000).duration_s(), 3 * 3600.0);
  write_silence(path_, 1000, 7 * 3600 * 1000);
  EXPECT_TRUE(mentions(load_error(), "longer than 6 hours"));
}

TEST_F(AudioFile, RefusesHeadersThatLie) {
  save_wav(path_, sine(300.0, 16000, 16000));
  const auto good = core::read_text(path_);
  const auto with = [&](size_t place, uint64_t value, size_t bytes) {
    auto changed = good;
    std::memcpy(changed.data() + place, &value, bytes);
    return changed;
  };
  write(with(22, 0, 2));  // no channels
  EXPECT_FALSE(load_error().empty());
  write(with(34, 77, 2));  // bits a sample
  EXPECT_FALSE(load_error().empty());
  write(with(good.find("data") + 4, 64000, 4));  // twice the sound there is
  EXPECT_TRUE(mentions(load_error(), "truncated"));
}

TEST_F(AudioFile, SavingMakesNoCopyOfTheSoundInMemory) {
  // libsndfile is C: nothing may be thrown through its frames, so its callbacks must not allocate.
  const Audio audio = sine(300.0, 16000, 400000);
  allocation_limit = 100000;
  EXPECT_NO_THROW(save_wav(path_, audio));
  allocation_limit = SIZE_MAX;
  EXPECT_EQ(load_audio(path_, 16000).samples.size(), audio.samples.size());
}

TEST_F(AudioFile, AFullDiskIsAnErrorThatNamesTheFile) {
  struct rlimit before {};
  ::getrlimit(RLIMIT_FSIZE, &before);
  const struct rlimit small { 20000, before.rlim_max };
  const auto ignored = std::signal(SIGXFSZ, SIG_IGN);
  ::setrlimit(RLIMIT_FSIZE, &small);
  std::string message;
  try {
    save_wav(path_, sine(300.0, 16000, 400000));
  } catch (const std::runtime_error& error) {
    message = error.what();
  }
  ::setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, ignored);
  EXPECT_NE(message.find(path_.filename().string()), std::string::npos) << message;
  EXPECT_TRUE(std::filesystem::is_empty(dir_));
}

TEST_F(AudioFile, SaveRefusesNothingAndLeavesNothingBehind) {
  EXPECT_THROW(save_wav(path_, Audio{}), std::invalid_argument);
  EXPECT_THROW(save_wav(path_, Audio{{std::nanf("")}, 16000}), std::invalid_argument);
  EXPECT_THROW(save_wav(path_, sine(300.0, 16000, 10), 12), std::invalid_argument);
  EXPECT_TRUE(std::filesystem::is_empty(dir_));
  std::ofstream(dir_ / "file") << "x";
  EXPECT_THROW(save_wav(dir_ / "file" / "sound.wav", sine(300.0, 16000, 10)), std::runtime_error);
}

}  // namespace
}  // namespace freetalk::audio
