// Feeds damaged sound files to the audio door: each must load or be refused in one sentence.
//
// Usage: audio FOLDER COUNT SEED. Seeds are short files of many formats made here; each case is one
// of them with some bytes changed, cut, repeated or overwritten with telling numbers. The case at
// work lies in FOLDER/case.bin, so that it is at hand after a crash.
#include <sndfile.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/file.h"
#include "freetalk/audio/audio.h"

/// libsndfile forgets the vorbis_info of some damaged OGG files (a few KiB each); not ours to free.
extern "C" const char* __lsan_default_suppressions() { return "leak:libvorbis\n"; }

namespace {

constexpr int kSecondsPerCase = 20;
using Random = std::mt19937_64;

size_t below(Random& random, size_t limit) { return random() % std::max<size_t>(1, limit); }

/// 60 ms of a tone in a format, or nothing where this libsndfile does not write it.
std::string make_seed(const std::filesystem::path& path, int format, int rate, int channels) {
  SF_INFO info{};
  info.format = format;
  info.samplerate = rate;
  info.channels = channels;
  if (!sf_format_check(&info)) {
    return "";
  }
  SNDFILE* file = sf_open(path.c_str(), SFM_WRITE, &info);
  if (file == nullptr) {
    return "";
  }
  sf_set_string(file, SF_STR_TITLE, "tone");
  std::vector<float> samples(static_cast<size_t>(rate * 6 / 100 * channels));
  for (size_t i = 0; i < samples.size(); ++i) {
    samples[i] = 0.5F * std::sin(0.1F * static_cast<float>(i / static_cast<size_t>(channels)));
  }
  sf_writef_float(file, samples.data(), static_cast<sf_count_t>(samples.size()) / channels);
  sf_close(file);
  return freetalk::core::read_text(path);
}

std::map<std::string, std::string> make_seeds(const std::filesystem::path& folder) {
  const std::map<std::string, int> containers = {
      {"wav", SF_FORMAT_WAV},   {"wavex", SF_FORMAT_WAVEX}, {"rf64", SF_FORMAT_RF64},
      {"w64", SF_FORMAT_W64},   {"aiff", SF_FORMAT_AIFF},   {"au", SF_FORMAT_AU},
      {"caf", SF_FORMAT_CAF},   {"flac", SF_FORMAT_FLAC},   {"ogg", SF_FORMAT_OGG},
      {"mpeg", SF_FORMAT_MPEG}, {"voc", SF_FORMAT_VOC},     {"nist", SF_FORMAT_NIST}};
  const std::map<std::string, int> codings = {
      {"u8", SF_FORMAT_PCM_U8},     {"s8", SF_FORMAT_PCM_S8},  {"16", SF_FORMAT_PCM_16},
      {"24", SF_FORMAT_PCM_24},     {"32", SF_FORMAT_PCM_32},  {"float", SF_FORMAT_FLOAT},
      {"double", SF_FORMAT_DOUBLE}, {"ulaw", SF_FORMAT_ULAW},  {"ima", SF_FORMAT_IMA_ADPCM},
      {"ms", SF_FORMAT_MS_ADPCM},   {"gsm", SF_FORMAT_GSM610}, {"alac", SF_FORMAT_ALAC_16},
      {"vorbis", SF_FORMAT_VORBIS}, {"opus", SF_FORMAT_OPUS},  {"mp3", SF_FORMAT_MPEG_LAYER_III}};
  std::map<std::string, std::string> seeds;
  for (const auto& [container, major] : containers) {
    for (const auto& [coding, minor] : codings) {
      for (const int channels : {1, 3}) {
        const std::string name = container + "-" + coding + "-" + std::to_string(channels);
        const int rate = coding == "opus" || coding == "mp3" ? 48000 : 16000;
        const auto bytes = make_seed(folder / "seed.bin", major | minor, rate, channels);
        if (!bytes.empty()) {
          seeds[name] = bytes;
        }
      }
    }
  }
  return seeds;
}

/// One change. Headers are changed more often than the sound behind them.
void mutate(std::string& bytes, Random& random) {
  static const std::vector<uint64_t> kTelling = {0,
                                                 1,
                                                 0x7F,
                                                 0x80,
                                                 0xFF,
                                                 0x7FFF,
                                                 0x8000,
                                                 0xFFFF,
                                                 0x7FFFFFFF,
                                                 0x80000000,
                                                 0xFFFFFFFF,
                                                 0x7FFFFFFFFFFFFFFF,
                                                 0x8000000000000000,
                                                 ~0ULL};
  if (bytes.empty()) {
    return;
  }
  const size_t reach = random() % 3 != 0 ? std::min<size_t>(bytes.size(), 96) : bytes.size();
  const size_t place = below(random, reach);
  switch (random() % 7) {
    case 0:
      bytes[place] = static_cast<char>(random());
      break;
    case 1:
      bytes[place] = static_cast<char>(bytes[place] ^ (1 << random() % 8));
      break;
    case 2: {  // a number of 1, 2, 4 or 8 bytes
      uint64_t value = kTelling[below(random, kTelling.size())];
      const size_t width = size_t{1} << random() % 4;
      for (size_t i = 0; i < width && place + i < bytes.size(); ++i) {
        bytes[place + i] = static_cast<char>(value >> (8 * i));
      }
      break;
    }
    case 3:
      bytes.resize(place);
      break;
    case 4:
      bytes.erase(place, 1 + below(random, 64));
      break;
    case 5:
      bytes.insert(place, bytes.substr(below(random, bytes.size()), 1 + below(random, 64)));
      break;
    default:
      bytes.replace(place, 1 + below(random, 16), 1 + below(random, 16),
                    static_cast<char>(random()));
  }
}

void on_alarm(int) {
  static const char kMessage[] = "HANG: a case took too long; it is in case.bin\n";
  const auto written = write(STDERR_FILENO, kMessage, sizeof kMessage - 1);
  std::_Exit(written > 0 ? 3 : 4);
}

/// The number of samples, or -1 for a refusal.
int64_t load(const std::filesystem::path& path) {
  try {
    const auto audio = freetalk::audio::load_audio(path);
    audio.check();
    if (audio.samples.empty()) {
      throw std::logic_error("loaded nothing without saying so");
    }
    return static_cast<int64_t>(audio.samples.size());
  } catch (const std::runtime_error& error) {
    const std::string message = error.what();
    if (message.find(path.string()) == std::string::npos || message.size() > 1000) {
      throw std::logic_error("a message that does not name the file: " + message);
    }
    return -1;
  }
}

}  // namespace

int main(int count_arguments, char** arguments) {
  if (count_arguments != 4) {
    std::fprintf(stderr, "usage: %s FOLDER COUNT SEED\n", arguments[0]);
    return 2;
  }
  const std::filesystem::path folder = arguments[1];
  const auto count = std::strtoull(arguments[2], nullptr, 10);
  Random random(std::strtoull(arguments[3], nullptr, 10));
  const auto seeds = make_seeds(folder);
  std::vector<std::string> names;
  for (const auto& [name, bytes] : seeds) {
    names.push_back(name);
    freetalk::core::write_file_atomic(folder / "case.bin", bytes);
    if (load(folder / "case.bin") <= 0) {
      std::fprintf(stderr, "%s: the file as written is refused\n", name.c_str());
      return 1;
    }
  }
  std::signal(SIGALRM, on_alarm);
  uint64_t loaded = 0, refused = 0;
  double slowest = 0.0;
  for (uint64_t i = 0; i < count; ++i) {
    auto bytes = seeds.at(names[below(random, names.size())]);
    for (size_t changes = 1 + below(random, 6); changes > 0; --changes) {
      mutate(bytes, random);
    }
    freetalk::core::write_file_atomic(folder / "case.bin", bytes);
    alarm(kSecondsPerCase);
    const auto start = std::chrono::steady_clock::now();
    (load(folder / "case.bin") > 0 ? loaded : refused) += 1;
    const std::chrono::duration<double> spent = std::chrono::steady_clock::now() - start;
    slowest = std::max(slowest, spent.count());
    alarm(0);
  }
  std::printf("%zu kinds of file, %llu cases: %llu loaded, %llu refused, slowest %.2f s\n",
              names.size(), static_cast<unsigned long long>(count),
              static_cast<unsigned long long>(loaded), static_cast<unsigned long long>(refused),
              slowest);
  std::fflush(stdout);
  return 0;
}
