// What STM's decoder takes in of each frame.
#pragma once

#include <ATen/core/Tensor.h>

namespace freetalk::stm {

/// What the decoder takes in of each frame: with W the part of its first layer (of C channels) that
/// sees the attention's result,
///   hidden_t = MeshFeatures.hidden + offset_t + W [softmax(q_h k_th^T) v_th of all heads h].
struct FrameInputs {
  at::Tensor offsets;  // (T, C), undefined for none
  at::Tensor keys;    // (T, heads, 68, d_head) divided by sqrt(d_head); undefined without attention
  at::Tensor values;  // (T, heads, 68, d_head)
};

}  // namespace freetalk::stm
