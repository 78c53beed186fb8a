// Speech features while the speech is still being recorded.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <memory>
#include <optional>

#include "freetalk/speech/encoder.h"
#include "freetalk/speech/features.h"

namespace freetalk::speech {

class PieceEncoder;

/// Options for a stream: 4 s of context, 0.4 s of lookahead, a piece each 0.4 s: a delay of at most
/// latency_s() = 0.85 s. A piece costs as much as encoding window_s = 4.8 s.
EncodeOptions stream_options();

/// Encodes speech as it comes: push() samples, get the features that are final.
///
/// The frames are those of encode_speech with the same options and `streamable`, however the
/// samples are divided over the calls. The wave, and the group norm of base encoders, are
/// normalised with the statistics of what has been heard. Memory does not grow.
class SpeechStream {
 public:
  /// @param encoder shared, not copied; not to be trained meanwhile
  /// @param fps of the motion, > 0, frame t at t / fps; nothing for the encoder's own frames
  /// @param options window_s, context_s, lookahead_s and fade_s set the delay
  /// @param layer_weights as in encode_speech
  explicit SpeechStream(SpeechEncoder encoder, std::optional<double> fps = std::nullopt,
                        EncodeOptions options = stream_options(),
                        std::optional<at::Tensor> layer_weights = std::nullopt);
  ~SpeechStream();
  SpeechStream(SpeechStream&&) noexcept;

  /// @param samples (n,) float in [-1, 1], 16 kHz, not normalised; n may be 0
  /// @return (m, C) float32, the next frames that are final, m may be 0
  at::Tensor push(const at::Tensor& samples);

  /// The rest of the frames, as if the speech ended here; the stream then starts afresh.
  /// @return (m, C)
  at::Tensor finish();

  /// Longest time between a frame's moment and the sample that makes it final: a piece's own part,
  /// the lookahead and half of the fade.
  double latency_s() const;

  /// Numbers held between calls: they stop growing with the window.
  int64_t num_held() const;

 private:
  SpeechEncoder encoder_;
  std::optional<double> fps_;
  EncodeOptions options_;
  std::optional<at::Tensor> layer_weights_;
  std::unique_ptr<PieceEncoder> pieces_;
  int64_t num_samples_ = 0;
};

}  // namespace freetalk::speech
