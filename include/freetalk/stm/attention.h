// What STM's cross-attention looks at [FreeTalk, Eq. 13-14; supp. Fig. 2].
#pragma once

#include "freetalk/stm/stm.h"

namespace freetalk::stm {

/// Weight of every landmark for every vertex: softmax_j(q_i . k_tj / sqrt(d_head)). The decoder
/// does not need the weights as such; this is for looking at them.
/// @param model with a fusion that attends ("ca", "ca_concat" or "gcn_ca_concat").
/// @param mesh as encode() gives it.
/// @param landmarks (T, 68, 3) displacements, metres.
/// @returns (T, heads, V, 68), each row sums to one.
/// @throws std::invalid_argument the model does not attend, or the shapes do not fit.
at::Tensor attention(StmImpl& model, const MeshFeatures& mesh, const at::Tensor& landmarks);

}  // namespace freetalk::stm
