// Emotions as the ATS takes them: convex mixtures and intensities, constant or changing over time.
#pragma once

#include <ATen/core/Tensor.h>

#include <string>
#include <vector>

namespace freetalk::ats {

/// Emotions of a motion and how much of each a frame feels. Every emotion is the network's
/// condition for a whole window, as in training, and the estimates of x_0 are blended frame by
/// frame: a condition that changed within a window would spread over it by self-attention.
struct Affect {
  at::Tensor emotion;    // (K, E) float, convex mixtures over AtsOptions::emotions
  at::Tensor intensity;  // (K,) float in [1, num_intensities]
  at::Tensor weight;     // (T, K) float, each frame's sum to one; undefined: K is one
};

/// One emotion for all frames. @param emotion (E,).
Affect constant_affect(const at::Tensor& emotion, double intensity);

/// What the face feels at one moment.
struct EmotionKey {
  double time_s = 0;
  at::Tensor emotion;  // (E,) convex mixture
  double intensity = 2;
};

/// Linear from key to key, held before the first and after the last.
/// @param keys at least one, their times rising.
Affect interpolate(const std::vector<EmotionKey>& keys, int64_t num_frames, double fps);

/// "happy", "Fear" (an alias, of any case) or "happy:0.7,sad:0.3" to a convex mixture (E,) over
/// `emotions`. What weights leave of one is neutral: "happy:0.3" is a weak happiness. Weights of
/// several that add up to more are shares.
/// @throws std::invalid_argument listing the known emotions and the nearest of them, or for one
/// emotion with a weight above 1.
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
