// Motion of any length from speech features: DDIM over overlapping windows that are denoised
// together.
//
// Every reverse step splits the noisy sequence into windows of max_frames, predicts x_0 in each,
// and cross-fades the predictions where windows overlap, so the windows agree at every noise level
// and no seam is left.
#pragma once

#include <string>
#include <vector>

#include "freetalk/ats/ats.h"
#include "freetalk/diffusion/ddim.h"

namespace freetalk::ats {

struct GenerateOptions {
  int64_t num_steps = 100;           // DDIM reverse steps [FreeTalk 3.1]
  double eta = 0.0;                  // DDIM noise, 0: deterministic given the seed's x_T
  std::string spacing = "trailing";  // timestep spacing, see diffusion::DdimOptions
  double audio_guidance = 1.0;       // classifier-free guidance on the audio; 1: off
  double affect_guidance = 1.0;      // classifier-free guidance on emotion and intensity; 1: off
  int64_t window_overlap = 30;       // frames shared by neighbouring windows, < max_frames
  int64_t windows_per_batch = 4;     // windows denoised at once: bounds memory
  template <class V>
  void fields(V& v) {
    v("num_steps", num_steps);
    v("eta", eta);
    v("spacing", spacing);
    v("audio_guidance", audio_guidance);
    v("affect_guidance", affect_guidance);
    v("window_overlap", window_overlap);
    v("windows_per_batch", windows_per_batch);
  }
  void check() const;
};

/// First frames of windows of `window` frames that cover `num_frames` and overlap by at least
/// `overlap`.
std::vector<int64_t> window_starts(int64_t num_frames, int64_t window, int64_t overlap);

/// @param model in eval mode. @param features (T, C) speech features at the model's fps.
/// @param emotion (E,) convex mixture. @param intensity in [1, num_intensities].
/// @param generator draws x_T (and the noise of eta > 0).
/// @returns (T, 68, 3) float32 landmark displacements, metres, canonical frame.
/// @throws std::invalid_argument on shapes or values out of range.
at::Tensor generate(Ats& model, const at::Tensor& features, const at::Tensor& emotion,
                    double intensity, const GenerateOptions& options, at::Generator generator,
                    const diffusion::StepCallback& on_step = {});

/// "happy", "fear" (an alias) or "happy:0.7,sad:0.3" to a convex mixture (E,) over `emotions`.
/// @throws std::invalid_argument listing the known emotions.
at::Tensor parse_emotion(const std::string& text, const std::vector<std::string>& emotions);

}  // namespace freetalk::ats
