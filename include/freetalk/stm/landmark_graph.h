// The fixed graph of the 68 iBUG / Multi-PIE landmarks and graph convolutions on it.
#pragma once

#include <torch/nn/module.h>
#include <torch/nn/modules/linear.h>
#include <torch/nn/pimpl.h>

#include <array>
#include <utility>
#include <vector>

#include "freetalk/core/conventions.h"

namespace freetalk::stm {

/// Edges (i < j) of the landmark graph: the iBUG contours (jaw 0-16, brows 17-21 and 22-26, nose
/// bridge 27-30 and base 31-35, eyes 36-41 and 42-47, outer lips 48-59, inner lips 60-67), with
/// symmetric links across mouth (inner to outer lips, upper to lower), eyes (upper to lower lid,
/// brow to lid), nose (bridge to base, to the inner eye corners) and jaw (to its mirror image, to
/// mouth and brows), so that the graph is connected.
const std::vector<std::pair<int64_t, int64_t>>& landmark_edges();

/// Index of each landmark's mirror image (left-right).
const std::array<int64_t, core::kNumLandmarks>& landmark_mirror();

/// D^-1/2 (A + I) D^-1/2 of the landmark graph [Kipf & Welling 2017]: (68, 68) float32.
at::Tensor landmark_adjacency();

/// Graph convolutions: x <- ReLU(A x W + b), linear at the end [FreeTalk 3.2].
class GcnImpl : public torch::nn::Module {
 public:
  GcnImpl(int64_t in_channels, int64_t hidden, int64_t num_layers);
  /// @param x (T, 68, in_channels). @returns (T, 68, hidden).
  at::Tensor forward(const at::Tensor& x);

 private:
  at::Tensor adjacency_;
  std::vector<torch::nn::Linear> layers_;
};
TORCH_MODULE(Gcn);

}  // namespace freetalk::stm
