// A clip of any length, encoded in overlapping pieces that are cross-faded.
//
// Piece k is responsible for [k hop, (k + 1) hop) and is encoded with `context` before and
// `lookahead` after that, as far as there is speech. Around each border the features of both
// neighbours are blended over `fade`.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <optional>

#include "freetalk/speech/encoder.h"
#include "freetalk/speech/features.h"
#include "statistics.h"

namespace freetalk::speech {

/// Values of `features` (..., S', C) at fractional frame positions (T,) double, ends held.
at::Tensor interpolate_frames(const at::Tensor& features, at::Tensor positions);

/// Sum of hidden states (B, S', C) by weights (num_states,).
at::Tensor mix_states(const std::vector<at::Tensor>& states, const at::Tensor& weights);

/// Evaluation mode for a scope, then every submodule as it was. A module that is in evaluation mode
/// is left alone: several threads may share it.
class EvaluationScope {
 public:
  explicit EvaluationScope(torch::nn::Module& module);
  ~EvaluationScope();
  EvaluationScope(const EvaluationScope&) = delete;
  EvaluationScope& operator=(const EvaluationScope&) = delete;

 private:
  torch::nn::Module& module_;
  std::vector<bool> was_training_;  // empty: nothing to restore
};

class PieceEncoder {
 public:
  /// @param fps rate of the result's frames, or nothing for the encoder's own
  /// @param layer_weights (num_hidden_layers + 1,) or nothing for options.layer
  PieceEncoder(SpeechEncoder encoder, std::optional<double> fps, const EncodeOptions& options,
               const std::optional<at::Tensor>& layer_weights);

  /// Normalises with the statistics of this whole clip, and takes it as one piece if it is short
  /// enough. Before the first push().
  void set_clip(const at::Tensor& samples);

  /// Frames (n, C) that are final with these further samples (n,).
  at::Tensor push(const at::Tensor& samples);
  /// The rest, up to the end of the clip.
  at::Tensor finish();

  int64_t num_frames(int64_t num_samples) const;
  double latency_s() const;
  int64_t hop() const { return hop_; }
  /// Numbers held between calls.
  int64_t num_held() const { return buffer_.numel() + (tail_.defined() ? tail_.numel() : 0); }
  at::TensorOptions result_options() const;

 private:
  at::Tensor run_piece(int64_t end, bool last);
  /// Features (n, C) of output frames [first, stop) from samples [start, start + wave.size(0)).
  at::Tensor encode_frames(const at::Tensor& wave, int64_t start, int64_t first, int64_t stop);
  at::Tensor encode_layers(const at::Tensor& features);
  /// Output frames before a moment, in samples.
  int64_t frames_before(double samples) const;
  at::Tensor blend_with_tail(const at::Tensor& values, double border) const;
  /// Empties the buffer up to what the next piece needs.
  void forget();

  SpeechEncoder encoder_;
  std::optional<double> fps_;
  EncodeOptions options_;
  std::optional<at::Tensor> layer_weights_;
  FrameTiming output_;
  int64_t hop_, context_, lookahead_;
  double fade_;

  WaveStatistics statistics_;
  bool whole_clip_ = false;  // statistics are complete
  int64_t counted_ = 0;      // samples in the statistics, when they grow

  at::Tensor buffer_;
  int64_t buffer_start_ = 0, heard_ = 0;
  int64_t piece_ = 0, last_end_ = 0;
  int64_t next_frame_ = 0;
  at::Tensor tail_;  // frames next_frame_ ... of the last piece, not final yet
};

}  // namespace freetalk::speech
