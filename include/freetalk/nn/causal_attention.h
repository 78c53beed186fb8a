// Self-attention that looks back over a window of frames and never ahead, so that a sequence may be
// continued from the keys and values of the frames before it.
#pragma once

#include "freetalk/nn/transformer.h"

namespace freetalk::nn {

/// Keys and values of the frames before a piece of a sequence; undefined at its beginning.
struct PastFrames {
  at::Tensor keys, values;  // (B, heads, P, d_head)
};

/// What all layers share about a piece of T frames whose first P keys lie before it.
struct CausalSpan {
  /// Cosines and sines of the rotary positions [RoFormer, Su et al. 2021, Eq. 34], (T, d_head)
  /// each; undefined: positions are not rotary.
  at::Tensor cosines, sines;
  at::Tensor allowed;  // (T, P + T) bool: frame i sees frames i - window + 1 ... i
};

/// @param first frame of the piece in its sequence. @param num_frames T.
/// @param window frames that a frame sees, itself included; 0: all before it.
/// @param head_dim d_head, even. @param rotary whether positions are rotary.
CausalSpan causal_span(int64_t first, int64_t num_frames, int64_t window, int64_t head_dim,
                       bool rotary, const at::TensorOptions& options);

/// Multi-head causal self-attention.
class CausalAttentionImpl : public AttentionHeads {
 public:
  using AttentionHeads::AttentionHeads;

  /// @param x (B, T, d). @param span of the T frames.
  /// @param window as of the span. @param past if not null: read, then brought to the last
  /// window - 1 frames of past and x.
  /// @returns (B, T, d).
  at::Tensor forward(const at::Tensor& x, const CausalSpan& span, int64_t window,
                     PastFrames* past = nullptr);
};
TORCH_MODULE(CausalAttention);

}  // namespace freetalk::nn
