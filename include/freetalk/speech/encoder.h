// HuBERT [Hsu et al. 2021] and wav2vec 2.0 [Baevski et al. 2020] encoders: 16 kHz speech in, 50 Hz
// features out.
//
// A stack of strided convolutions turns the wave into frames, a transformer puts each frame into
// its context. Parameter names are those of `HubertModel` / `Wav2Vec2Model` in Hugging Face
// `transformers`, so that their checkpoints load unchanged.
#pragma once

#include <ATen/core/Tensor.h>
#include <torch/nn/module.h>
#include <torch/nn/pimpl.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "freetalk/speech/options.h"

namespace freetalk::speech {

class FeatureExtractorImpl;
class FeatureProjectionImpl;
class TransformerImpl;
class InferenceCache;
struct WindowMoments;

/// When the frames of an encoder happen: frame i is centred at offset_s + i / rate_hz.
struct FrameTiming {
  double rate_hz = 50.0;     // 16000 / product of conv_stride
  double offset_s = 0.0125;  // half the receptive field (400 samples for the standard strides)
};

/// Without gradients, in evaluation mode and on a CPU, float32 and bfloat16 (parameters of that
/// type, or autocast) take a faster way to the same result: padding is left out, weight norm and
/// group norm are folded, activations fused. Training and other devices go through the modules.
class SpeechEncoderImpl : public torch::nn::Module {
 public:
  explicit SpeechEncoderImpl(SpeechEncoderOptions options = {});
  ~SpeechEncoderImpl() override;

  /// Last hidden state.
  /// @param wave (B, S) float, 16 kHz, see normalize_wave
  /// @param mask (B, S) bool or integer, nonzero where samples are real: a run of ones, then
  /// padding. Padded frames
  ///   are not attended to; their own output is meaningless. Each clip needs at least
  ///   receptive_field() real samples.
  /// @param layer hidden state to return: 0 is what the first layer gets, i what layer i gives,
  ///   num_hidden_layers or -1 the last; layers after it are not computed
  /// @return (B, S', C), S' = num_frames(S)
  at::Tensor forward(const at::Tensor& wave, const std::optional<at::Tensor>& mask = std::nullopt,
                     int64_t layer = -1);

  /// All num_hidden_layers + 1 hidden states, (B, S', C) each, as `output_hidden_states` of
  /// `transformers`; the last is that of forward().
  std::vector<at::Tensor> hidden_states(const at::Tensor& wave,
                                        const std::optional<at::Tensor>& mask = std::nullopt);

  /// First half of forward(): (B, S) -> (B, S', C_conv), the output of the convolutions.
  at::Tensor extract_features(const at::Tensor& wave,
                              const std::optional<at::Tensor>& mask = std::nullopt);

  /// Second half of forward(): projection and transformer.
  /// @param features (B, S', C_conv), at any frame rate
  /// @param valid_frames (B,) int64 number of real frames per clip, or nothing when all are
  /// @param layer hidden state to return, as in forward()
  /// @return (B, S', C)
  at::Tensor encode_features(const at::Tensor& features,
                             const std::optional<at::Tensor>& valid_frames = std::nullopt,
                             int64_t layer = -1);

  /// Second half of hidden_states().
  std::vector<at::Tensor> encode_states(
      const at::Tensor& features, const std::optional<at::Tensor>& valid_frames = std::nullopt);

  /// Frames of a clip: floor((n - kernel) / stride) + 1 layer after layer; for the standard
  /// extractor floor((n - 400) / 320) + 1, and 0 below the receptive field.
  int64_t num_frames(int64_t num_samples) const;

  /// The same for each clip of a batch, (B,) int64; nothing from nothing.
  std::optional<at::Tensor> count_frames(std::optional<at::Tensor> num_samples) const;

  /// Samples that one frame sees (400 for the standard extractor).
  int64_t receptive_field() const;

  /// Samples between frames (320 for the standard extractor).
  int64_t frame_stride() const;

  FrameTiming timing() const;

  const SpeechEncoderOptions& options() const { return options_; }

  void train(bool on = true) override;

 private:
  friend class PieceEncoder;  // normalises a clip as a whole while it encodes it in pieces

  /// extract_features() after its checks. `valid` real samples per clip (B,), `moments` of the
  /// clip for group norm in place of those of the wave.
  at::Tensor extract(const at::Tensor& wave, const std::optional<at::Tensor>& valid,
                     const WindowMoments* moments);
  at::Tensor extract_fast(const at::Tensor& wave, const std::optional<at::Tensor>& valid,
                          const WindowMoments* moments, at::ScalarType dtype);
  /// The hidden state `layer`, and into `states` all up to it where it is not null.
  at::Tensor encode(const at::Tensor& features, const std::optional<at::Tensor>& valid_frames,
                    int64_t layer, std::vector<at::Tensor>* states);
  at::Tensor encode_fast(const at::Tensor& features, const std::optional<at::Tensor>& valid_frames,
                         int64_t layer, std::vector<at::Tensor>* states, at::ScalarType dtype);
  /// Checks the arguments of forward(); real samples per clip (B,) int64, or nothing when all are
  /// real.
  std::optional<at::Tensor> check_wave(const at::Tensor& wave,
                                       const std::optional<at::Tensor>& mask) const;

  SpeechEncoderOptions options_;
  std::shared_ptr<FeatureExtractorImpl> feature_extractor_;
  std::shared_ptr<FeatureProjectionImpl> feature_projection_;
  std::shared_ptr<TransformerImpl> encoder_;
  std::unique_ptr<InferenceCache> inference_;
};
TORCH_MODULE(SpeechEncoder);

}  // namespace freetalk::speech
