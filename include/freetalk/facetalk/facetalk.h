// The denoiser of FaceTalk [Aneja et al. 2024, Sec. 4]: G(x_t, t, A) -> x_0 over expression codes.
//
//   memory = W_a A                  speech features, one a frame; the learned null where dropped
//   z = W_x x_t;  per layer: causal self-attention over a window of frames [Eq. 6], what is heard
//   at the frame itself [Eq. 7], feed-forward, each followed by what the step t says [Eq. 19];
//   x_0 = W_o z
//
// As no frame looks ahead, motion of any length comes in one pass, and frame by frame (generate.h).
// The diffusion runs on normalised codes (x - code_mean) / code_scale; the two are buffers, and so
// are rest_code, the code of the face at rest, and landmark_basis, what codes do to 68 landmarks.
#pragma once

#include <torch/nn/module.h>
#include <torch/nn/modules/container/modulelist.h>
#include <torch/nn/modules/linear.h>
#include <torch/nn/pimpl.h>

#include <string>
#include <vector>

#include "freetalk/diffusion/schedule.h"
#include "freetalk/nn/film.h"

namespace freetalk::facetalk {

struct FaceTalkOptions {
  /// What the codes are: "head" (expression codes of a parametric head) or "weights" (of named
  /// expressions, as Table 3's FLAME variant).
  std::string codes = "head";
  std::string head;                      // hash of the head that the codes belong to
  std::vector<std::string> expressions;  // names of the weights
  int64_t code_dim = 200;                // theta_exp
  /// What is heard: "audio" features, or "landmarks" (displacements of 68 points, m, Fig. 8).
  std::string condition = "audio";
  int64_t audio_dim = 768;  // channels of the condition
  int64_t d_model = 256;    // [supp. B]
  int64_t num_layers = 4;   // [supp. B]
  int64_t num_heads = 8;    // [supp. B]
  int64_t ff_dim = 1024;    // [supp. B]
  double dropout = 0.1;     // unstated
  bool norm_first = true;   // unstated; true as EDGE
  std::string activation = "gelu";
  int64_t time_layers = 3;  // of the step's MLP: 3 [Sec. 4] or 2 [supp. B]
  /// How the step is told: "film", "scale_shift", "squeeze_excite", "dot_product" or "input" [Table
  /// 5], see nn/film.h.
  std::string time_condition = "film";
  std::string film_form = "residual";  // "residual", or "plain" as Eq. 19 is printed
  bool align_audio = true;             // Eq. 7; false: frames hear the whole clip [Table 2]
  std::string positions = "rotary";    // unstated; "rotary", or "learned" for up to max_frames
  int64_t window = 48;                 // frames that self-attention sees; 0: all before
  int64_t max_frames = 48;             // of learned positions
  double fps = 24.0;                   // [Sec. 4]
  /// Where speech features are brought to the motion's rate: of the encoder's convolutions ("conv",
  /// Sec. 4) or of its "output".
  std::string feature_resampling = "conv";
  bool diffusion = true;            // false: one pass from nothing [Table 2, w/o diffusion]
  std::string schedule = "cosine";  // [Sec. 6]
  int64_t num_train_steps = 1000;   // [Sec. 6]
  double beta_start = 1e-4;         // of schedule "linear"
  double beta_end = 0.02;
  template <class V>
  void fields(V& v) {
    v("codes", codes);
    v("head", head);
    v("expressions", expressions);
    v("code_dim", code_dim);
    v("condition", condition);
    v("audio_dim", audio_dim);
    v("d_model", d_model);
    v("num_layers", num_layers);
    v("num_heads", num_heads);
    v("ff_dim", ff_dim);
    v("dropout", dropout);
    v("norm_first", norm_first);
    v("activation", activation);
    v("time_layers", time_layers);
    v("time_condition", time_condition);
    v("film_form", film_form);
    v("align_audio", align_audio);
    v("positions", positions);
    v("window", window);
    v("max_frames", max_frames);
    v("fps", fps);
    v("feature_resampling", feature_resampling);
    v("diffusion", diffusion);
    v("schedule", schedule);
    v("num_train_steps", num_train_steps);
    v("beta_start", beta_start);
    v("beta_end", beta_end);
  }
  void check() const;
  diffusion::ScheduleOptions schedule_options() const;
  nn::FilmLayerOptions layer_options() const;
};

/// What is heard, of one batch.
struct Condition {
  at::Tensor audio;       // (B, T, C) float, speech features or landmarks at the motion's frames
  at::Tensor drop_audio;  // (B,) bool, true: the learned null audio (guidance); undefined: none
  at::Tensor valid;       // (B, T) bool, false on padding at the end; matters without align_audio
};

class FaceTalkImpl : public torch::nn::Module {
 public:
  explicit FaceTalkImpl(const FaceTalkOptions& options);

  /// @param x (B, T, code_dim) noisy normalised codes. @param timestep (B,) int64.
  /// @returns (B, T, code_dim), the estimate of the clean normalised codes.
  at::Tensor forward(const at::Tensor& x, const at::Tensor& timestep, const Condition& condition);

  /// Codes to the normalised space of the diffusion, and back. (..., code_dim).
  at::Tensor normalize(const at::Tensor& codes) const;
  at::Tensor denormalize(const at::Tensor& codes) const;
  /// @param mean, scale, rest (code_dim,); scale > 0. @param landmark_basis (code_dim, 204) m.
  void set_code_statistics(const at::Tensor& mean, const at::Tensor& scale, const at::Tensor& rest,
                           const at::Tensor& landmark_basis);
  /// (codes - rest_code) landmark_basis: exact for weights, least squares over the training data
  /// for codes of a head. @param codes (..., code_dim). @returns (..., 68, 3) displacements, m.
  at::Tensor landmarks(const at::Tensor& codes) const;
  const at::Tensor& rest_code() const { return rest_code_; }

  const FaceTalkOptions& options() const { return options_; }

 private:
  friend class Inference;  // computes once what does not depend on the step
  void check_inputs(const at::Tensor& x, const at::Tensor& timestep,
                    const Condition& condition) const;
  at::Tensor time_code(const at::Tensor& timestep);  // (N,) to (N, d)
  /// W_a A of frames from `first` on, (B, T, d).
  at::Tensor memory(const at::Tensor& audio, const at::Tensor& drop_audio, int64_t first);
  nn::CausalSpan span(int64_t first, int64_t num_frames, const at::TensorOptions& options) const;
  /// (T, d), added to the input of T frames from `first` on; undefined: nothing.
  at::Tensor input_positions(int64_t first, int64_t num_frames) const;
  /// All that sees x. @param code (B, d) of the step. @param past of each layer; null: none.
  at::Tensor decode(const at::Tensor& x, const at::Tensor& code, const at::Tensor& positions,
                    const std::vector<at::Tensor>& heard, const at::Tensor& heard_valid,
                    const std::vector<nn::PlaceTerms>& terms, const nn::CausalSpan& span,
                    std::vector<nn::PastFrames>* past);

  FaceTalkOptions options_;
  torch::nn::Linear input_proj_{nullptr}, audio_proj_{nullptr}, output_proj_{nullptr};
  std::vector<torch::nn::Linear> time_mlp_;
  std::vector<nn::FilmDecoderLayer> layers_;
  torch::nn::LayerNorm norm_{nullptr};
  at::Tensor positions_, null_audio_;
  at::Tensor code_mean_, code_scale_, rest_code_, landmark_basis_;
};
TORCH_MODULE(FaceTalk);

}  // namespace freetalk::facetalk
