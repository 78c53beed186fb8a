#include "freetalk/stm/attention.h"

#include <ATen/ops/matmul.h>
#include <ATen/ops/softmax.h>

#include "freetalk/core/error.h"

namespace freetalk::stm {

at::Tensor attention(StmImpl& model, const MeshFeatures& mesh, const at::Tensor& landmarks) {
  FREETALK_CHECK(model.options().uses_attention(), "STM: fusion \"", model.options().fusion,
                 "\" has no attention to look at");
  FREETALK_CHECK(mesh.queries.defined(), "STM: expected the features of a mesh with queries");
  const at::Tensor keys = model.frame_inputs(landmarks).keys;  // (T, heads, 68, d_head), scaled
  return at::softmax(at::matmul(mesh.queries.unsqueeze(0), keys.transpose(-2, -1)), -1);
}

}  // namespace freetalk::stm
