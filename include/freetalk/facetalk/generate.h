// Expression codes of any length from speech features, whole or while the speech is being heard.
//
// No frame of the denoiser looks ahead, at any step of the diffusion. So a piece of frames is taken
// through all reverse steps before the next one is begun: each step and layer keeps the keys and
// values of the last window of frames. Pieces give what the whole would give, up to rounding, and
// memory beside input and result does not grow with length.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "freetalk/diffusion/sampler.h"
#include "freetalk/facetalk/facetalk.h"

namespace freetalk::facetalk {

struct GenerateOptions {
  std::string sampler = "ddim";  // "ddim", "ddpm", "dpmpp" or "renoise" [FaceTalk Eq. 9]
  int64_t num_steps = 50;        // reverse steps; the paper takes 1000 of "renoise"
  double eta = 0.0;              // noise of "ddim"
  std::string spacing = "auto";  // of timesteps, see diffusion::SamplerOptions
  double audio_guidance = 1.0;   // w of Eq. 10; 1: off
  double temperature = 1.0;      // in [0, 1], scale of all noise: less is likelier and less varied
  int64_t piece_frames = 240;    // of generate(); bounds memory
  std::string precision = "float32";  // of the network: "float32" (the weights' own) or "bfloat16"
  template <class V>
  void fields(V& v) {
    v("sampler", sampler);
    v("num_steps", num_steps);
    v("eta", eta);
    v("spacing", spacing);
    v("audio_guidance", audio_guidance);
    v("temperature", temperature);
    v("piece_frames", piece_frames);
    v("precision", precision);
  }
  void check() const;
  diffusion::SamplerOptions sampler_options() const;
};

/// Codes while the speech is being heard: there is no delay beside the features' own. The frames
/// are those of generate() with the same seeds, however the features are divided over the calls.
/// Not to be shared between threads; the model may be.
class CodeStream {
 public:
  /// @param model in eval mode, of speech features aligned with the motion. @param seeds K of them,
  /// of as many motions of the one speech.
  /// @throws std::invalid_argument for options out of range, or a model that hears whole clips.
  CodeStream(FaceTalk model, std::vector<uint64_t> seeds, const GenerateOptions& options = {});
  ~CodeStream();
  CodeStream(CodeStream&&) noexcept;

  /// @param features (n, C) of the next frames; n may be 0.
  /// @returns (K, n, code_dim) float32 codes of those frames.
  at::Tensor push(const at::Tensor& features, const diffusion::StepCallback& on_step = {});
  /// Starts afresh.
  void reset();

  /// Numbers held between calls: they stop growing with the window.
  int64_t num_held() const;

 private:
  friend at::Tensor generate(FaceTalk& model, const at::Tensor& features,
                             const GenerateOptions& options, const std::vector<uint64_t>& seeds,
                             const diffusion::StepCallback& on_step);
  struct State;
  std::unique_ptr<State> state_;
};

/// K motions of one speech, sampled together. With guidance the estimate of x_0 is
/// w c + (1 - w) u [FaceTalk Eq. 10], c with and u without audio.
/// @param model in eval mode. @param features (T, C) speech features, or landmarks, at its fps.
/// @param seeds K: each draws the noise of one motion, the same whatever K is.
/// @returns (K, T, code_dim) float32 codes.
/// @throws std::invalid_argument on shapes or values out of range.
at::Tensor generate(FaceTalk& model, const at::Tensor& features, const GenerateOptions& options,
                    const std::vector<uint64_t>& seeds,
                    const diffusion::StepCallback& on_step = {});

}  // namespace freetalk::facetalk
