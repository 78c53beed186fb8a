// The encoder for inference on a CPU: the same function as the modules in layers.h, from the same
// parameters, with everything folded that can be.
//
// Clips of a batch are worked on without their padding: their frames stand one after another in one
// matrix (N, C), so that products are shared, and attention and convolutions see one clip at a
// time. The convolutions run over short stretches of time, channels last, so that their large
// intermediate results stay in the processor's cache.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "freetalk/speech/options.h"
#include "kernels/onednn.h"
#include "statistics.h"

namespace freetalk::speech {

class InferenceEncoder {
 public:
  /// @param state parameters by their names in SpeechEncoder, on the CPU
  /// @param dtype of the products, float32 or bfloat16; norms, softmax and sums stay in float32
  InferenceEncoder(const SpeechEncoderOptions& options,
                   const std::map<std::string, at::Tensor>& state, at::ScalarType dtype);

  /// The convolutions.
  /// @param wave (S,) float32, at least the receptive field
  /// @param moments of the clip, for group norm
  /// @return (S', C_conv) of the type of the products
  at::Tensor extract(const at::Tensor& wave, const std::optional<WindowMoments>& moments) const;

  /// Projection and transformer.
  /// @param features (N, C_conv), the frames of all clips
  /// @param lengths frames per clip, their sum is N
  /// @param layer hidden state to stop at, in [0, num_hidden_layers]
  /// @param states takes hidden states 0 ... layer where it is not null
  /// @return (N, C) float32
  at::Tensor encode(const at::Tensor& features, const std::vector<int64_t>& lengths, int64_t layer,
                    std::vector<at::Tensor>* states = nullptr) const;

 private:
  struct Norm {
    at::Tensor weight, bias;
    double eps = 1e-5;
    at::Tensor operator()(const at::Tensor& x) const;
  };
  struct ConvLayer {
    std::optional<kernels::FixedConv> conv;  // all but the first
    std::optional<Norm> norm;
  };
  struct Layer {
    kernels::FixedLinear q, k, v, out, up, down;
    Norm attention_norm, final_norm;
  };

  at::Tensor first_layer(const at::Tensor& wave, const at::Tensor& weight,
                         const at::Tensor& bias) const;
  at::Tensor conv_layer(const at::Tensor& x, size_t index) const;
  at::Tensor attend(const Layer& layer, const at::Tensor& x,
                    const std::vector<int64_t>& lengths) const;
  at::Tensor add_positions(const at::Tensor& x, const std::vector<int64_t>& lengths) const;
  at::Tensor apply_layer(const Layer& layer, const at::Tensor& x,
                         const std::vector<int64_t>& lengths) const;

  SpeechEncoderOptions options_;
  at::ScalarType dtype_;
  int64_t receptive_field_ = 1, stride_ = 1;
  at::Tensor first_weight_, first_bias_;  // (C, 1, k), float32
  std::vector<ConvLayer> conv_layers_;
  std::optional<Norm> projection_norm_;
  std::optional<kernels::FixedLinear> projection_;
  std::optional<kernels::FixedConv> positions_;
  Norm encoder_norm_;
  std::vector<Layer> layers_;
};

}  // namespace freetalk::speech
