// First weights with which attention looks at frames near its own, each head at another distance,
// as the taps of a convolution do [Cordonnier et al. 2020]. From random weights it begins as a mean
// over all frames allowed, and learns to tell neighbours apart only after thousands of steps.
#pragma once

#include <ATen/core/Tensor.h>

#include "freetalk/nn/transformer.h"

namespace freetalk::nn {

/// Codes of positions whose inner products fall off within a few frames: (cos(t w_0..), sin(t
/// w_0..)) in the first d_model / num_heads channels, periods from 3 to 150 frames; 0 in the
/// others.
/// @returns (num_frames, d_model) float32.
at::Tensor local_position_code(int64_t num_frames, int64_t d_model, int64_t num_heads);

/// Sets what queries and keys read of local_position_code(), so that the heads attend mostly to
/// distances spaced evenly over (-radius / 2, radius / 2) frames; all else stays as it is.
void start_locally(MultiheadAttention& attention, double radius);

}  // namespace freetalk::nn
