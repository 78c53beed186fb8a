// What STM's decoder takes in of each frame.
#pragma once

#include <ATen/core/Tensor.h>

namespace freetalk::stm {

/// What the decoder takes in of each frame, its first layer (of C channels) applied:
///   hidden_t = MeshFeatures.hidden + offset_t + sum_h softmax(q_h k_th^T) v_th.
struct FrameInputs {
  at::Tensor offsets;  // (T, C), undefined for none
  at::Tensor keys;    // (T, heads, 68, d_head) divided by sqrt(d_head); undefined without attention
  at::Tensor values;  // (T, heads, 68, C)
};

}  // namespace freetalk::stm
