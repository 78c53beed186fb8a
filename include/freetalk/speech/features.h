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
/// @return (B, T, C) or (T, C)
at::Tensor resample_features(const at::Tensor& features, int64_t num_frames, double fps,
                             FrameTiming timing = {});

/// The same when the frame rate is not at hand: num_frames are spread evenly over the clip. A clip
/// with S' encoder frames lasts between S' * 20 ms + 5 ms and S' * 20 ms + 25 ms; the middle is
/// taken, so times are off by 10 ms at most.
at::Tensor resample_features(const at::Tensor& features, int64_t num_frames);

/// Memory bound of encode_speech.
struct EncodeOptions {
  double window_s =
      20.0;  // longest piece encoded at once, > 2 context_s; clips up to this length are one piece
  double context_s = 2.0;  // speech on each side of a piece that its features may look at, > 0

  template <class V>
  void fields(V& v) {
    v("window_s", window_s);
    v("context_s", context_s);
  }
  void check() const;
};

/// Motion frames of a clip: round(num_samples / 16000 * fps), at least 1.
int64_t num_motion_frames(int64_t num_samples, double fps);

/// Speech features for every motion frame of a clip of any length, without gradients and without
/// dropout.
///
/// The wave is normalised once. Longer clips are encoded in equal windows that overlap by at least
/// 2 context_s and are cross-faded over context_s in the middle of each overlap: memory grows only
/// with the result. With a group norm extractor (HuBERT base and tiny) the norm's statistics belong
/// to each window, so that features of a long clip differ slightly from one pass over the whole.
/// @param encoder left as it was (device, training mode)
/// @param samples (S,) float in [-1, 1], 16 kHz, not normalised; moved to the encoder's device
/// window by window
/// @param fps of the motion, > 0
/// @param progress called with the finished share in (0, 1]
/// @return (T, C), T = num_motion_frames(S, fps), on the encoder's device
at::Tensor encode_speech(SpeechEncoder& encoder, const at::Tensor& samples, double fps,
                         const EncodeOptions& options = {},
                         const std::function<void(double)>& progress = {});

}  // namespace freetalk::speech
