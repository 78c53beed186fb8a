// Transformer decoder layers that are told something in every place, such as the step of a
// diffusion: by FiLM [Perez et al. 2018; FaceTalk Eq. 19], or in one of the other ways of FaceTalk
// Fig. 10.
//
// With y the output of self-attention, cross-attention or feed-forward, x what it is added to and
// c the code to tell, a place gives
//
//   film            x + y (1 + g) + b,  (g, b) = W mish(c) + w    [as EDGE, Tseng et al. 2023]
//                   film_form "plain": (x + y) g + b, as Eq. 19 is printed; g starts at 1
//   scale_shift     (x + y) (1 + g) + b, (g, b) = W c + w of one layer for the three places
//   squeeze_excite  x + y sigmoid(W_2 relu(W_1 c + w_1) + w_2): the code is the squeezed
//                   descriptor, as a mean over frames would look ahead [Hu et al. 2018]
//   dot_product     x + y + a (W_v c - y), a = softmax over (y, k) of the frame's query: each frame
//                   attends to itself and to the code
//   input           x + y: the code is added to the decoder's input
#pragma once

#include <torch/nn/module.h>
#include <torch/nn/modules/dropout.h>
#include <torch/nn/modules/linear.h>
#include <torch/nn/modules/normalization.h>
#include <torch/nn/pimpl.h>

#include <array>
#include <string>
#include <vector>

#include "freetalk/nn/causal_attention.h"
#include "freetalk/nn/transformer.h"

namespace freetalk::nn {

struct FilmLayerOptions {
  TransformerLayerOptions transformer;
  std::string condition = "film";      // see above
  std::string film_form = "residual";  // "residual" or "plain"
  bool aligned = true;  // each frame hears the memory of its own moment alone [FaceTalk Eq. 7]
  int64_t window = 48;  // frames that self-attention sees, see causal_span()
  void check() const;
};

/// What a code says in the three places of a layer, (B, k) each; undefined: nothing.
using PlaceTerms = std::array<at::Tensor, 3>;

/// One place, see above.
class FilmPlaceImpl : public torch::nn::Module {
 public:
  FilmPlaceImpl(int64_t d_model, const FilmLayerOptions& options);

  /// What does not depend on the frames. @param code (B, d). @returns (B, k).
  at::Tensor terms(const at::Tensor& code);
  /// @param x what y is added to. @param y (B, T, d). @param terms (B, k). @returns (B, T, d).
  at::Tensor forward(const at::Tensor& x, const at::Tensor& y, const at::Tensor& terms);

 private:
  FilmLayerOptions options_;
  torch::nn::Linear linear_{nullptr}, squeeze_{nullptr}, query_{nullptr};
};
TORCH_MODULE(FilmPlace);

class FilmDecoderLayerImpl : public torch::nn::Module {
 public:
  explicit FilmDecoderLayerImpl(const FilmLayerOptions& options);

  /// @param code (B, d).
  PlaceTerms terms(const at::Tensor& code);

  /// What cross-attention reads of the memory, once for all steps. Aligned: its output, which is
  /// out(V(a_i)) as the softmax over the one key allowed is 1; else the memory itself.
  /// @param memory (B, T, d). @returns (B, T, d).
  at::Tensor heard(const at::Tensor& memory);

  /// @param x (B, T, d). @param heard (B, T, d) of heard().
  /// @param heard_valid (B, 1, 1, T) bool, read where layers are not aligned; undefined: all.
  /// @param terms of terms(). @param span of the frames. @param past see CausalAttention.
  /// @returns (B, T, d).
  at::Tensor forward(const at::Tensor& x, const at::Tensor& heard, const at::Tensor& heard_valid,
                     const PlaceTerms& terms, const CausalSpan& span, PastFrames* past = nullptr);

 private:
  at::Tensor placed(size_t place, const at::Tensor& x, const at::Tensor& y,
                    const PlaceTerms& terms);

  FilmLayerOptions options_;
  CausalAttention self_attn_{nullptr};
  torch::nn::Linear value_{nullptr}, audio_out_{nullptr};  // aligned
  MultiheadAttention multihead_attn_{nullptr};             // not aligned
  torch::nn::Linear linear1_{nullptr}, linear2_{nullptr};
  torch::nn::LayerNorm norm1_{nullptr}, norm2_{nullptr}, norm3_{nullptr};
  torch::nn::Dropout dropout_{nullptr};
  std::vector<FilmPlace> places_;  // three; one for all of scale_shift; none of input
};
TORCH_MODULE(FilmDecoderLayer);

}  // namespace freetalk::nn
