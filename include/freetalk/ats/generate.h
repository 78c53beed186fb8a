// Motion of any length from speech features: reverse diffusion over overlapping windows.
//
// Neighbouring windows are denoised together, a group at a time: every reverse step predicts x_0 in
// each window and cross-fades the predictions where windows overlap, so the windows agree at every
// noise level and no seam is left. A group hands its predictions for the frames that it shares with
// the next group on to it, step by step, so memory beside input and result does not grow with
// length.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "freetalk/ats/articulation.h"
#include "freetalk/ats/ats.h"
#include "freetalk/ats/emotion.h"
#include "freetalk/diffusion/sampler.h"

namespace freetalk::ats {

struct GenerateOptions {
  std::string sampler = "ddim";       // "ddim", "ddpm" or "dpmpp", see diffusion::SamplerOptions
  int64_t num_steps = 100;            // reverse steps [FreeTalk 3.1]; "dpmpp" needs 10 to 20
  double eta = 0.0;                   // noise of "ddim", 0: deterministic given the seed's x_T
  std::string spacing = "auto";       // of timesteps, see diffusion::SamplerOptions
  double audio_guidance = 1.0;        // w_a, classifier-free guidance on the audio; 1: off
  double affect_guidance = 1.0;       // w_e, the same on emotion and intensity; 1: off
  double mouth_temperature = 1.0;     // in [0, 1], scale of the mouth's noise, see generate()
  double articulation = 1.0;          // in (0, 3], gain of the mouth's motion, see articulate()
  int64_t window_overlap = 30;        // frames shared by neighbouring windows, < max_frames
  int64_t windows_per_batch = 4;      // windows of a group, denoised at once: bounds memory
  std::string precision = "float32";  // of the network: "float32" (the weights' own) or "bfloat16"
  template <class V>
  void fields(V& v) {
    v("sampler", sampler);
    v("num_steps", num_steps);
    v("eta", eta);
    v("spacing", spacing);
    v("audio_guidance", audio_guidance);
    v("affect_guidance", affect_guidance);
    v("mouth_temperature", mouth_temperature);
    v("articulation", articulation);
    v("window_overlap", window_overlap);
    v("windows_per_batch", windows_per_batch);
    v("precision", precision);
  }
  void check() const;
  diffusion::SamplerOptions sampler_options() const;
};

/// First frames of windows of `window` frames that cover `num_frames` and overlap by at least
/// `overlap`.
std::vector<int64_t> window_starts(int64_t num_frames, int64_t window, int64_t overlap);

/// K motions of one speech, sampled together. With guidance the estimate of x_0 is
/// c + (w_a - 1) (c - c_without_audio) + (w_e - 1) (c - c_without_affect), c the conditional one
/// [Ho and Salimans 2022, for two conditions].
/// A mouth_temperature below 1 scales all noise of mouth, nose and jaw down, which leads to
/// likelier, less varied motion that follows the speech more closely [as Grad-TTS, Popov et al.
/// 2021, 3.3]; brows and eyes, which speech hardly determines, keep theirs and blink as before.
/// @param model in eval mode. @param features (T, C) speech features at the model's fps.
/// @param affect the emotions and their weights in every frame. @param generators K of them: each
/// draws the noise of one motion, which is that of its generator alone up to rounding.
/// @returns (K, T, 68, 3) float32 landmark displacements, metres, canonical frame.
/// @throws std::invalid_argument on shapes or values out of range.
at::Tensor generate(Ats& model, const at::Tensor& features, const Affect& affect,
                    const GenerateOptions& options, std::vector<at::Generator> generators,
                    const diffusion::StepCallback& on_step = {});

/// One motion with one emotion. @param emotion (E,) convex mixture.
/// @param intensity in [1, num_intensities]. @returns (T, 68, 3).
at::Tensor generate(Ats& model, const at::Tensor& features, const at::Tensor& emotion,
                    double intensity, const GenerateOptions& options, at::Generator generator,
                    const diffusion::StepCallback& on_step = {});

}  // namespace freetalk::ats
