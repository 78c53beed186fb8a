#include "freetalk/ats/emotion.h"

#include <ATen/ATen.h>
#include <torch/types.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <sstream>

#include "core/number.h"
#include "freetalk/core/error.h"
#include "freetalk/core/options.h"

namespace freetalk::ats {
namespace {

const std::map<std::string, std::string>& emotion_aliases() {
  static const std::map<std::string, std::string> aliases = {
      {"fear", "afraid"},        {"fearful", "afraid"},        {"anger", "angry"},
      {"happiness", "happy"},    {"sadness", "sad"},           {"disgusted", "disgust"},
      {"surprised", "surprise"}, {"contemptuous", "contempt"}, {"joy", "happy"},
      {"joyful", "happy"},       {"scared", "afraid"},         {"mad", "angry"},
      {"furious", "angry"},      {"unhappy", "sad"},           {"sorrow", "sad"},
      {"shame", "ashamed"},      {"astonished", "surprise"},   {"calm", "neutral"},
      {"content", "pleased"}};
  return aliases;
}

std::string lower(std::string text) {
  for (char& c : text) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  return text;
}

int64_t emotion_index(const std::string& name, const std::vector<std::string>& emotions) {
  const std::string wanted = lower(name);
  const auto alias = emotion_aliases().find(wanted);
  const std::string& canonical = alias == emotion_aliases().end() ? wanted : alias->second;
  for (size_t i = 0; i < emotions.size(); ++i) {
    if (lower(emotions[i]) == canonical) return static_cast<int64_t>(i);
  }
  std::string known;
  for (const std::string& emotion : emotions) known += (known.empty() ? "" : ", ") + emotion;
  throw std::invalid_argument(core::join("unknown emotion '", name, "', did you mean '",
                                         core::nearest_name(wanted, emotions),
                                         "'? known are: ", known));
}

std::string trimmed(const std::string& text) {
  const size_t first = text.find_first_not_of(" \t\n");
  if (first == std::string::npos) return "";
  return text.substr(first, text.find_last_not_of(" \t\n") - first + 1);
}

std::vector<std::string> split(const std::string& text, char separator) {
  std::vector<std::string> parts;
  std::istringstream stream(text);
  for (std::string part; std::getline(stream, part, separator);) parts.push_back(trimmed(part));
  return parts;
}

std::optional<double> number(const std::string& text) {
  const char* const first = text.data() + text.starts_with('+');
  double value = 0;
  const auto [end, error] = core::parse_number(first, text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) {
    return std::nullopt;
  }
  return value;
}

EmotionKey parse_key(const std::string& text, const std::vector<std::string>& emotions,
                     double intensity, bool timed) {
  EmotionKey key;
  std::string rest = text;
  const size_t equals = rest.find('=');
  if (equals != std::string::npos) {
    const auto time = number(trimmed(rest.substr(0, equals)));
    FREETALK_CHECK(time && *time >= 0, "emotion key '", text, "': '", rest.substr(0, equals),
                   "' is not a time in seconds");
    key.time_s = *time;
    rest = trimmed(rest.substr(equals + 1));
  } else {
    FREETALK_CHECK(!timed, "emotion key '", text, "' has no time; write 'TIME=", text,
                   "' with TIME in seconds");
  }
  key.intensity = intensity;
  const size_t at_sign = rest.find('@');
  if (at_sign != std::string::npos) {
    const auto level = number(trimmed(rest.substr(at_sign + 1)));
    FREETALK_CHECK(level, "emotion key '", text, "': '", rest.substr(at_sign + 1),
                   "' is not an intensity");
    key.intensity = *level;
    rest = trimmed(rest.substr(0, at_sign));
  }
  key.emotion = parse_emotion(rest, emotions);
  return key;
}

}  // namespace

Affect constant_affect(const at::Tensor& emotion, double intensity) {
  return {emotion.unsqueeze(0), at::full({1}, intensity, emotion.options()), {}};
}

Affect interpolate(const std::vector<EmotionKey>& keys, int64_t num_frames, double fps) {
  FREETALK_CHECK(!keys.empty() && num_frames > 0 && fps > 0,
                 "emotion keys: expected at least one key, one frame and a positive frame rate");
  for (size_t i = 1; i < keys.size(); ++i) {
    FREETALK_CHECK(keys[i].time_s > keys[i - 1].time_s, "emotion keys: times must rise, found ",
                   keys[i].time_s, " s after ", keys[i - 1].time_s, " s");
  }
  std::vector<at::Tensor> emotions;
  std::vector<float> intensities;
  for (const EmotionKey& key : keys) {
    emotions.push_back(key.emotion);
    intensities.push_back(static_cast<float>(key.intensity));
  }
  const at::Tensor weight = at::zeros({num_frames, static_cast<int64_t>(keys.size())}, at::kFloat);
  auto at_frame = weight.accessor<float, 2>();
  size_t after = 0;  // the first key that lies after the frame
  for (int64_t frame = 0; frame < num_frames; ++frame) {
    const double time = static_cast<double>(frame) / fps;
    while (after < keys.size() && keys[after].time_s <= time) ++after;
    const size_t next = std::min(after, keys.size() - 1), last = after > 0 ? after - 1 : 0;
    const double span = keys[next].time_s - keys[last].time_s;
    const double share = span > 0 ? (time - keys[last].time_s) / span : 0;
    at_frame[frame][static_cast<int64_t>(last)] += static_cast<float>(1 - share);
    at_frame[frame][static_cast<int64_t>(next)] += static_cast<float>(share);
  }
  return {at::stack(emotions), torch::tensor(intensities), weight};
}

at::Tensor parse_emotion(const std::string& text, const std::vector<std::string>& emotions) {
  std::vector<float> mixture(emotions.size(), 0.0F);
  float total = 0;
  for (const std::string& part : split(text, ',')) {
    const size_t colon = part.find(':');
    double weight = 1;
    if (colon != std::string::npos) {
      const auto given = number(trimmed(part.substr(colon + 1)));
      FREETALK_CHECK(given && *given >= 0 && *given < 1e6, "emotion '", text, "': the weight '",
                     part.substr(colon + 1), "' is not a number >= 0");
      weight = *given;
    }
    FREETALK_CHECK(part.find('=') == std::string::npos, "emotion '", text,
                   "': keys are separated by ';', the emotions of one by ','");
    const int64_t index = emotion_index(trimmed(part.substr(0, colon)), emotions);
    mixture[static_cast<size_t>(index)] += static_cast<float>(weight);
    total += static_cast<float>(weight);
  }
  FREETALK_CHECK(total > 0, "emotion '", text, "' names no emotion with a positive weight");
  const bool alone = text.find(',') == std::string::npos;
  FREETALK_CHECK(!alone || total <= 1, "emotion '", text,
                 "': a weight is a share of at most 1; for how strong it is write '@INTENSITY'");
  const auto neutral = std::find(emotions.begin(), emotions.end(), "neutral");
  if (total < 1 && neutral != emotions.end()) {  // a weaker emotion
    mixture[static_cast<size_t>(neutral - emotions.begin())] += 1 - total;
    total = 1;
  }
  return torch::tensor(mixture) / total;
}

std::vector<EmotionKey> parse_emotion_keys(const std::string& text,
                                           const std::vector<std::string>& emotions,
                                           double intensity) {
  const auto parts = split(text, ';');
  std::vector<EmotionKey> keys;
  for (const std::string& part : parts) {
    keys.push_back(parse_key(part, emotions, intensity, parts.size() > 1));
    FREETALK_CHECK(keys.size() < 2 || keys.back().time_s > keys[keys.size() - 2].time_s,
                   "emotion key '", part, "': times must rise");
  }
  FREETALK_CHECK(!keys.empty(), "emotion must not be empty");
  return keys;
}

}  // namespace freetalk::ats
