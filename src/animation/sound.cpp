#include "sound.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

namespace freetalk::animation {
namespace {

constexpr size_t kHeader = 44;
constexpr float kLargest = 32767.0f;

void put(std::string& out, uint64_t value, int bytes) {
  for (int k = 0; k < bytes; ++k) out.push_back(static_cast<char>(value >> (8 * k)));
}

uint32_t u32_at(const std::string& bytes, size_t at) {
  uint32_t value = 0;
  for (size_t k = 0; k < 4; ++k) value |= uint32_t{static_cast<uint8_t>(bytes[at + k])} << (8 * k);
  return value;
}

}  // namespace

std::string wav_bytes(const audio::Audio& audio) {
  const uint64_t data = 2 * audio.samples.size();
  const auto rate = static_cast<uint64_t>(audio.sample_rate_hz);
  std::string out = "RIFF";
  put(out, kHeader - 8 + data, 4);
  out += "WAVEfmt ";
  put(out, 16, 4);
  put(out, 1, 2);  // PCM
  put(out, 1, 2);  // one channel
  put(out, rate, 4);
  put(out, 2 * rate, 4);
  put(out, 2, 2);   // bytes a frame
  put(out, 16, 2);  // bits a sample
  out += "data";
  put(out, data, 4);
  out.reserve(out.size() + data);
  for (const float sample : audio.samples) {
    const float level = std::clamp(sample, -1.0f, 1.0f);
    put(out, static_cast<uint16_t>(static_cast<int16_t>(std::lrint(kLargest * level))), 2);
  }
  return out;
}

audio::Audio parse_wav(const std::string& bytes) {
  audio::Audio audio;
  const bool ours = bytes.size() >= kHeader && bytes.compare(0, 4, "RIFF") == 0 &&
                    bytes.compare(8, 8, "WAVEfmt ") == 0 && u32_at(bytes, 20) == 0x10001 &&
                    bytes[34] == 16 && bytes.compare(36, 4, "data") == 0;
  if (!ours) return audio;
  audio.sample_rate_hz = u32_at(bytes, 24);
  if (audio.sample_rate_hz < audio::kMinSampleRateHz ||
      audio.sample_rate_hz > audio::kMaxSampleRateHz) {
    return {};
  }
  const size_t end = std::min<size_t>(bytes.size(), kHeader + u32_at(bytes, 40));
  for (size_t at = kHeader; at + 1 < end; at += 2) {
    const int low = static_cast<uint8_t>(bytes[at]), high = static_cast<int8_t>(bytes[at + 1]);
    audio.samples.push_back(static_cast<float>(256 * high + low) / kLargest);
  }
  return audio;
}

std::filesystem::path sound_beside(const std::filesystem::path& path) {
  return path.parent_path() / (path.stem().string() + ".speech.wav");
}

}  // namespace freetalk::animation
