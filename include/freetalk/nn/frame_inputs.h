// What a decoder takes in of each frame.
#pragma once

#include <ATen/core/Tensor.h>

namespace freetalk::nn {

/// The network's input after its first linear layer, frame by frame:
///   hidden_t = base + offset_t + sum_h softmax(q_h k_th^T) v_th.
struct FrameInputs {
  at::Tensor offsets;  // (T, C), undefined for none
  at::Tensor keys;     // (T, H, N, d) already divided by sqrt(d); undefined without attention
  at::Tensor values;   // (T, H, N, C)
};

}  // namespace freetalk::nn
