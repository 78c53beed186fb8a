// A DiffusionNet on one mesh for inference on a CPU, many frames of it, without autograd.
//
// A block needs of the mesh only Phi, M Phi and G Phi, with the gradients G: with the spectrum
// s = exp(-lambda t) Phi^T M x, what is diffused is Phi s, its gradient is (G Phi) s, and what the
// gradient features multiply it with is (G Phi) (s A). So every vertex goes through the block by
// itself: vertices go through in tiles of rows that stay in the cache, and the next block's
// Phi^T M x is summed up on the way. Products run in float32 or, where the processor multiplies it,
// in bfloat16 with float32 sums, residuals and spectra.
#pragma once

#include <ATen/core/Tensor.h>

#include <memory>

#include "freetalk/nn/diffusion_net.h"

namespace freetalk::nn {

/// The network's input after its first linear layer, frame by frame:
///   hidden_t = base + offset_t + W [softmax(q_1 k_t1^T) v_t1, ..., softmax(q_H k_tH^T) v_tH].
struct FrameInputs {
  at::Tensor offsets;  // (T, C), undefined for none
  at::Tensor keys;     // (T, H, N, d) already divided by sqrt(d); undefined without attention
  at::Tensor values;   // (T, H, N, e)
};

/// What the network starts from: base (V, C), queries (H, V, d), mixing W (C, H e); queries and
/// mixing undefined without attention.
struct FusedInput {
  at::Tensor base, queries, mixing;
};

class FusedDiffusion {
 public:
  /// Whether this network on these operators is one it can run: spectral, with gradient features,
  /// MLPs of equal widths, outputs at the vertices of one mesh, all float32 on the CPU, no dropout.
  static bool supports(DiffusionNetImpl& net, const geometry::SurfaceOperators& operators);
  /// Whether bfloat16 is multiplied by this processor.
  static bool supports_bfloat16();

  /// Copies what it needs; later changes of the network do not reach it.
  FusedDiffusion(DiffusionNetImpl& net, const geometry::SurfaceOperators& operators,
                 const FusedInput& input, bool bfloat16);
  ~FusedDiffusion();
  FusedDiffusion(FusedDiffusion&&) noexcept;
  FusedDiffusion& operator=(FusedDiffusion&&) noexcept;

  /// @param in_work frames in work at a time, at most one a thread.
  /// @returns (T, V, out_channels) float32. A frame's result does not depend on the others.
  at::Tensor run(const FrameInputs& inputs, int64_t num_frames, int64_t in_work) const;

  /// Bytes that a frame in work takes.
  int64_t bytes_per_frame() const;

  class Engine;

 private:
  std::unique_ptr<Engine> engine_;
};

}  // namespace freetalk::nn
