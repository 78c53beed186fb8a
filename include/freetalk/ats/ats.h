// ATS, Audio-To-Sparse [FreeTalk 3.1]: the transformer denoiser f(x_l, l, A, e, i) -> x_0 over
// landmark displacements.
//
//   Z = W_x x_l + P_tgt + g_t(l) + g_c(e, i), memory = W_h H + P_mem [Eq. 6]
//   each layer: self-attention, cross-attention within |i - j| <= r, feed-forward [Eq. 7-10]
//   x_0 = Z_out W_o + b_o [Eq. 11]
//
// The diffusion runs on normalised displacements (x - motion_mean) / motion_scale; the two are
// buffers.
#pragma once

#include <torch/nn/module.h>
#include <torch/nn/modules/container/modulelist.h>
#include <torch/nn/modules/embedding.h>
#include <torch/nn/modules/linear.h>
#include <torch/nn/pimpl.h>

#include <string>
#include <vector>

#include "freetalk/core/conventions.h"
#include "freetalk/diffusion/schedule.h"
#include "freetalk/nn/transformer.h"

namespace freetalk::ats {

using core::kMotionDim;
using core::kNumLandmarks;

struct AtsOptions {
  int64_t d_model = 512;            // d [supp. 2]
  int64_t num_layers = 6;           // decoder layers [supp. 2]
  int64_t num_heads = 8;            // [supp. 2]
  int64_t ff_dim = 2048;            // [supp. 2]
  double dropout = 0.1;             // unstated in the paper
  bool norm_first = false;          // unstated; false: post-norm as in Vaswani et al.
  std::string activation = "gelu";  // unstated; "gelu" or "relu"
  int64_t audio_dim = 768;          // C, channels of the speech features
  int64_t max_frames = 600;  // learned positions; longer motion is generated in overlapping windows
  /// Longest motion that training showed, within max_frames: windows of generation are no longer.
  /// 0: max_frames. Written by training.
  int64_t trained_frames = 0;
  /// Training also showed windows whose first frames are known, see Condition::known: streams then
  /// go on from what was shown. Written by training.
  bool known_prefix = false;
  int64_t band_radius = 3;  // r of Eq. 9, frames; unstated in the paper; -1: no band
  /// First weights of positions and attention, unstated in the paper: "local" (each head at frames
  /// near its own, see nn/local_start.h) or "random".
  std::string attention_start = "local";
  int64_t num_intensities = 3;  // learned levels 1 .. num_intensities
  double fps = 30.0;            // frames per second of the motion
  std::vector<std::string> emotions = {"neutral", "afraid", "ashamed",  "angry",   "disgust",
                                       "happy",   "sad",    "drunk",    "ill",     "suspicious",
                                       "pleased", "upset",  "surprise", "contempt"};
  std::string schedule = "linear";  // noise schedule, see diffusion::ScheduleOptions
  int64_t num_train_steps = 1000;   // T_d
  double beta_start = 1e-4;
  double beta_end = 0.02;
  template <class V>
  void fields(V& v) {
    v("d_model", d_model);
    v("num_layers", num_layers);
    v("num_heads", num_heads);
    v("ff_dim", ff_dim);
    v("dropout", dropout);
    v("norm_first", norm_first);
    v("activation", activation);
    v("audio_dim", audio_dim);
    v("max_frames", max_frames);
    v("trained_frames", trained_frames);
    v("known_prefix", known_prefix);
    v("band_radius", band_radius);
    v("attention_start", attention_start);
    v("num_intensities", num_intensities);
    v("fps", fps);
    v("emotions", emotions);
    v("schedule", schedule);
    v("num_train_steps", num_train_steps);
    v("beta_start", beta_start);
    v("beta_end", beta_end);
  }
  void check() const;
  /// Frames of a window of generation.
  int64_t window_frames() const { return trained_frames > 0 ? trained_frames : max_frames; }
  diffusion::ScheduleOptions schedule_options() const;
};

/// What the denoiser is conditioned on; tensors of one batch.
struct Condition {
  at::Tensor audio;  // (B, T, C) float, speech features at the motion's frames
  /// (B, E) or, changing over time, (B, T, E) float: convex mixtures over AtsOptions::emotions
  /// (one-hot: the paper).
  at::Tensor emotion;
  /// (B,) or (B, T), as the emotion: float in [1, num_intensities], interpolated between the
  /// learned levels.
  at::Tensor intensity;
  at::Tensor valid;        // (B, T) bool, false on padding; undefined: all valid
  at::Tensor drop_audio;   // (B,) bool, true: the learned null audio (guidance); undefined: none
  at::Tensor drop_affect;  // (B,) bool, true: the learned null affect; undefined: none
  /// (B,) int64, learned position of the first frame, so that training reaches positions that its
  /// sequences are too short for: in [0, max_frames - T]; undefined: 0.
  at::Tensor first_position;
  /// (B,) int64, first frames of x that are clean, of timestep 0, whatever the timestep of the
  /// others [as Diffusion Forcing, Chen et al. 2024]; undefined: 0.
  at::Tensor known;
};

class AtsImpl : public torch::nn::Module {
 public:
  explicit AtsImpl(const AtsOptions& options);

  /// @param x (B, T, 204) noisy normalised displacements, T <= max_frames. @param timestep (B,)
  /// int64.
  /// @returns (B, T, 204), the estimate of the clean normalised displacements.
  at::Tensor forward(const at::Tensor& x, const at::Tensor& timestep, const Condition& condition);

  /// Metres to the normalised space of the diffusion, and back. (..., 204).
  at::Tensor normalize(const at::Tensor& motion) const;
  at::Tensor denormalize(const at::Tensor& motion) const;
  /// @param mean, scale (204,) metres; scale > 0.
  void set_motion_statistics(const at::Tensor& mean, const at::Tensor& scale);

  const AtsOptions& options() const { return options_; }

 private:
  friend class AtsInference;  // computes once what does not depend on the step
  void start_locally();
  void check_inputs(const at::Tensor& x, const at::Tensor& timestep,
                    const Condition& condition) const;
  at::Tensor time_code(const at::Tensor& timestep);  // (B, d)
  /// (B, 1, d), or (B, T, d) where some frames are known.
  at::Tensor time_code_of_frames(const at::Tensor& timestep, const Condition& condition);
  at::Tensor affect_code(const Condition& condition);  // (B, 1, d) or (B, T, d)
  at::Tensor audio_memory(const Condition& condition);
  /// (T, d), or (B, T, d) where the windows begin at different positions.
  at::Tensor positions_of(const at::Tensor& table, const Condition& condition) const;

  AtsOptions options_;
  torch::nn::Linear input_proj_{nullptr}, memory_proj_{nullptr}, output_proj_{nullptr};
  at::Tensor target_positions_, memory_positions_, null_audio_, null_affect_;
  torch::nn::Linear time_in_{nullptr}, time_out_{nullptr}, affect_in_{nullptr},
      affect_out_{nullptr};
  torch::nn::Embedding emotion_embedding_{nullptr}, intensity_embedding_{nullptr};
  std::vector<nn::TransformerDecoderLayer> layers_;
  torch::nn::LayerNorm norm_{nullptr};
  at::Tensor motion_mean_, motion_scale_;
};
TORCH_MODULE(Ats);

}  // namespace freetalk::ats
