// What morph targets do to the normals of a mesh.
#pragma once

#include <ATen/core/Tensor.h>

#include "freetalk/mesh/mesh.h"

namespace freetalk::animation {

/// Unit normals of the rest pose and their derivatives along each target: a viewer adds
/// sum_k w_k dn_k and normalises, which is right to first order in the motion, however targets
/// cancel. Vertices doubled along texture seams share a normal.
class MorphNormals {
 public:
  explicit MorphNormals(const mesh::Mesh& mesh);
  const at::Tensor& rest() const { return rest_; }  ///< (V, 3) float32
  /// @param target (V, 3) float32 displacements. @return (V, 3) float32.
  at::Tensor derivative(const at::Tensor& target) const;

 private:
  Eigen::MatrixXd vertices_;   // (W, 3) welded
  Eigen::MatrixXi faces_;      // (F, 3) of welded vertices
  Eigen::VectorXi vertex_of_;  // (V,)
  Eigen::MatrixXd normals_;    // (W, 3)
  Eigen::VectorXd lengths_;    // (W,) of the sums of face normals
  std::vector<int> first_;     // (W,) a vertex of the mesh at each welded one
  at::Tensor rest_;
};

}  // namespace freetalk::animation
