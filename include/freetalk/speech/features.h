// From samples to one feature vector per motion frame.
//
// Time, not index, links the two rates: encoder frame i is centred at i * 320 + 200 samples
// (FrameTiming), motion frame t happens at t / fps. Features are interpolated linearly between the
// two nearest encoder frames and held before the first and after the last centre.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "freetalk/speech/encoder.h"

namespace freetalk::speech {

/// (x - mean) / sqrt(variance + 1e-7) over the last dimension, as Hugging Face's feature extractor
/// does.
/// @param wave (S,) or (B, S) float
/// @param mask same shape, nonzero where samples are real: statistics from those alone, padding
/// becomes 0
at::Tensor normalize_wave(const at::Tensor& wave,
                          const std::optional<at::Tensor>& mask = std::nullopt);

/// Features of motion frames 0 ... num_frames-1, frame t at t / fps seconds. Differentiable in
/// `features`.
/// @param features (B, S', C) or (S', C) float
/// @param valid_frames (B,) int64 real frames of each clip, whose last one is held; nothing when
/// all are
/// @return (B, T, C) or (T, C)
at::Tensor resample_features(const at::Tensor& features, int64_t num_frames, double fps,
                             FrameTiming timing = {},
                             const std::optional<at::Tensor>& valid_frames = std::nullopt);

/// The same when the frame rate is not at hand: num_frames are spread evenly over the clip. A clip
/// with S' encoder frames lasts between S' * 20 ms + 5 ms and S' * 20 ms + 25 ms; the middle is
/// taken, so times are off by 10 ms at most.
at::Tensor resample_features(const at::Tensor& features, int64_t num_frames);

/// How encode_speech and SpeechStream work through speech of any length.
struct EncodeOptions {
  // Longest piece encoded at once, context and lookahead included. Clips up to it are one piece.
  // Memory grows with it, the difference from one pass over the clip shrinks (encode_speech).
  double window_s = 40.0;
  // Speech before the part of a piece that is used, at least 0.1.
  double context_s = 2.0;
  // Speech after it; in a stream, part of the delay. 0: as long as context_s.
  double lookahead_s = 0.0;
  // Cross-fade between pieces. 0: half of the shorter of context_s and lookahead_s.
  double fade_s = 0.0;
  // false: the wave, and the group norm of base encoders, are normalised over the whole clip.
  // true: over what has been heard up to the end of a piece, as a stream has to, and short clips
  // are cut into pieces like long ones: the result is that of SpeechStream.
  bool streamable = false;
  // Hidden state to take: 0 is what the first layer gets, i what layer i gives, -1 the last.
  int64_t layer = -1;
  // Where features take the rate of the motion: "output" (of the transformer) or "conv" (before
  // the transformer, as ScanTalk and FaceTalk do).
  std::string resample = "output";
  std::string precision = "float32";  // or "bfloat16": products in half precision

  template <class V>
  void fields(V& v) {
    v("window_s", window_s);
    v("context_s", context_s);
    v("lookahead_s", lookahead_s);
    v("fade_s", fade_s);
    v("streamable", streamable);
    v("layer", layer);
    v("resample", resample);
    v("precision", precision);
  }
  void check() const;
};

/// Motion frames of a clip: round(num_samples / 16000 * fps), at least 1.
int64_t num_motion_frames(int64_t num_samples, double fps);

/// Speech features for every motion frame of a clip of any length, without gradients and without
/// dropout.
///
/// Longer clips are encoded in pieces that overlap and are cross-faded: memory grows only with the
/// result. Normalisation sees the whole clip (EncodeOptions::streamable), so that the convolutions
/// give what they give in one pass; the transformer sees a piece with its context. What remains is
/// that its attention averages over all that it sees: a piece's average is an estimate of the
/// clip's, so the difference falls with the square root of window_s, and more context changes
/// nothing. Relative to one pass over 158 s of speech the shipped encoder's features differ by
/// 0.23 (window_s 6), 0.17 (12), 0.14 (20), 0.10 (40), 0.08 (60), root mean square.
/// @param encoder left as it was (device, training mode); shared by threads only in evaluation mode
/// @param samples (S,) float in [-1, 1], 16 kHz, not normalised; moved to the encoder's device
/// piece by piece
/// @param fps of the motion, > 0; nothing for the encoder's own frames
/// @param progress called with the finished share in (0, 1]
/// @param layer_weights (num_hidden_layers + 1,) weights of the hidden states, to sum them in
/// place of options.layer
/// @return (T, C) float32, T = num_motion_frames(S, fps), on the encoder's device
at::Tensor encode_speech(SpeechEncoder& encoder, const at::Tensor& samples,
                         std::optional<double> fps, const EncodeOptions& options = {},
                         const std::function<void(double)>& progress = {},
                         const std::optional<at::Tensor>& layer_weights = std::nullopt);

/// Speech features of a batch at the motion's frames, differentiable, in one pass: for training.
/// @param wave (B, S) float, normalised (normalize_wave)
/// @param mask (B, S) nonzero where samples are real, as in SpeechEncoder::forward
/// @param num_frames T of the result; frame t happens at t / fps
/// @param options layer and resample count
/// @param layer_weights as in encode_speech
/// @return (B, T, C); frames after the end of a clip hold nothing of meaning
at::Tensor motion_features(SpeechEncoder& encoder, const at::Tensor& wave,
                           const std::optional<at::Tensor>& mask, int64_t num_frames, double fps,
                           const EncodeOptions& options = {},
                           const std::optional<at::Tensor>& layer_weights = std::nullopt);

}  // namespace freetalk::speech
