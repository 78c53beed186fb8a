// A mesh's vertices in an order that keeps neighbours together, and its gradients row by row.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <vector>

#include "freetalk/geometry/operators.h"

namespace freetalk::nn {

/// The order's vertex i is vertex order[i] of the mesh. Gradients as kernels::GradientRows has
/// them.
struct MeshRows {
  /// @param operators of one mesh, on the CPU.
  explicit MeshRows(const geometry::SurfaceOperators& operators);

  at::Tensor order;            ///< (V,) int64
  std::vector<int32_t> first;  ///< (V + 1,)
  std::vector<int32_t> neighbor;
  std::vector<float> weight;  ///< X and Y of each
};

}  // namespace freetalk::nn
