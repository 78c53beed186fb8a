// Emotions as the ATS takes them: convex mixtures and intensities, constant or changing over time.
#pragma once

#include <ATen/core/Tensor.h>

#include <string>
#include <vector>

namespace freetalk::ats {

/// Emotion and intensity of every frame, or of all frames.
struct Affect {
  at::Tensor emotion;    // (T, E) or (E,) float, convex mixtures over AtsOptions::emotions
  at::Tensor intensity;  // (T,) or () float in [1, num_intensities]
};

/// The same emotion for all frames. @param emotion (E,).
Affect constant_affect(const at::Tensor& emotion, double intensity);

/// What the face feels at one moment.
struct EmotionKey {
  double time_s = 0;
  at::Tensor emotion;  // (E,) convex mixture
  double intensity = 2;
};

/// Mixture and intensity at every frame: linear between keys, held before the first and after the
/// last. A convex combination of convex mixtures is one.
/// @param keys at least one, their times rising.
Affect interpolate(const std::vector<EmotionKey>& keys, int64_t num_frames, double fps);

/// "happy", "fear" (an alias) or "happy:0.7,sad:0.3" to a convex mixture (E,) over `emotions`.
/// @throws std::invalid_argument listing the known emotions.
at::Tensor parse_emotion(const std::string& text, const std::vector<std::string>& emotions);

/// Keys from text: "TIME=EMOTION@INTENSITY" joined by ';', such as
/// "0=neutral; 2.5=happy:0.7,surprise:0.3@2.5". TIME in seconds may be missing where there is one
/// key,
/// @INTENSITY means `intensity` where it is missing.
/// @throws std::invalid_argument quoting the part at fault, or listing the known emotions.
std::vector<EmotionKey> parse_emotion_keys(const std::string& text,
                                           const std::vector<std::string>& emotions,
                                           double intensity);

}  // namespace freetalk::ats
