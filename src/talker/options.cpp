#include "freetalk/talker/options.h"

#include <array>
#include <charconv>
#include <cmath>

#include "freetalk/core/error.h"
#include "freetalk/diffusion/sampler.h"
#include "freetalk/geometry/alignment.h"
#include "freetalk/talker/models.h"

namespace freetalk::talker {
namespace {

/// The shortest text that reads back as the same number, in any locale.
std::string number(double value) {
  std::array<char, 32> text{};
  const auto end = std::to_chars(text.data(), text.data() + text.size(), value).ptr;
  return {text.data(), end};
}

std::string mixture_text(const EmotionKey& key) {
  FREETALK_CHECK(!key.mixture.empty(), "an emotion key at ", key.time_s, " s names no emotion");
  std::string text;
  for (const auto& [name, share] : key.mixture) {
    FREETALK_CHECK(name.find_first_of(",:;=@") == std::string::npos, "unknown emotion '", name,
                   "'");
    if (!text.empty()) text += ',';
    text += name + ':' + number(share);
  }
  return text;
}

bool finite(const std::optional<double>& value) { return !value || std::isfinite(*value); }

}  // namespace

std::string emotion_text(const std::vector<EmotionKey>& keys) {
  FREETALK_CHECK(!keys.empty(), "expected at least one emotion key");
  std::string text;
  for (const EmotionKey& key : keys) {
    if (!text.empty()) text += ';';
    text += number(key.time_s) + '=' + mixture_text(key);
    if (key.intensity) text += '@' + number(*key.intensity);
  }
  return text;
}

void FaceOptions::check() const {
  FREETALK_CHECK(precision == "float32" || precision == "bfloat16",
                 "precision must be float32 or bfloat16, found '", precision, "'");
  FREETALK_CHECK(engine == "stm" || engine == "head", "engine must be stm or head, found '", engine,
                 "'");
  FREETALK_CHECK(memory_mb >= 1, "memory_mb must be at least 1, found ", memory_mb);
  FREETALK_CHECK(
      follow_landmarks == "auto" || follow_landmarks == "yes" || follow_landmarks == "no",
      "follow_landmarks must be auto, yes or no, found '", follow_landmarks, "'");
  FREETALK_CHECK(!cache_dir || !cache_dir->empty(),
                 "cache_dir must name a folder, or be auto, or nothing for no cache");
  geometry::AlignOptions{unit, up, forward}.check();
}

void AnimateOptions::check() const {
  FREETALK_CHECK(!emotion.empty(), "emotion must not be empty");
  FREETALK_CHECK(finite(intensity), "intensity must be finite");
  FREETALK_CHECK(std::isfinite(fps) && fps > 0 && fps <= 240,
                 "fps must be above 0 and at most 240, found ", fps);
  FREETALK_CHECK(seed >= 0, "seed must not be negative, found ", seed);
  FREETALK_CHECK(motion == "ats" || motion == "facetalk", "motion must be ats or facetalk, found '",
                 motion, "'");
  if (sampler) diffusion::SamplerOptions{*sampler}.check();
  FREETALK_CHECK(num_steps.value_or(1) >= 1, "num_steps must be at least 1, found ",
                 num_steps.value_or(1));
  FREETALK_CHECK(
      finite(eta) && finite(audio_guidance) && finite(affect_guidance) && finite(mouth_temperature),
      "eta, audio_guidance, affect_guidance and mouth_temperature must be finite");
  FREETALK_CHECK(articulation >= 0.5 && articulation <= 1.5,
                 "articulation must be between 0.5 and 1.5, found ", articulation);
  FREETALK_CHECK(std::isfinite(tolerance_mm) && tolerance_mm >= 0,
                 "tolerance_mm must not be negative, found ", tolerance_mm);
}

void CodeMotionOptions::check() const {
  facetalk::GenerateOptions::check();
  FREETALK_CHECK(articulation > 0 && articulation <= 3,
                 "articulation must be above 0 and at most 3, found ", articulation);
}

void TalkerOptions::check() const {
  AnimateOptions::check();
  FaceOptions::check();
}

}  // namespace freetalk::talker
