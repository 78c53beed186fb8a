// A displacement sequence as few morph targets: D (T, 3V) ~ W (T, K) B (K, 3V).
//
// B spans the leading right singular vectors of D, from the eigenvectors of the smaller Gram matrix
// (D Dt, or Dt D when 3V < T). The rest pose stays the base shape: D is not centred. Weights lie in
// [0, 1], to which Blender and other programs clamp them: the range of each target's weights is
// moved there, and one more target, on in every frame, holds where the ranges begin.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <string>
#include <vector>

namespace freetalk::animation {

struct MorphBasis {
  at::Tensor targets;      ///< (K, V, 3) float32
  at::Tensor weights;      ///< (T, K) float32 in [0, 1]
  double max_error = 0.0;  ///< largest distance of a vertex from its displacement over all frames
};

/// The fewest leading targets whose largest vertex error is within `tolerance`, or `max_targets` of
/// them.
///
/// At most 512 frames, evenly spread, enter the Gram matrix; all frames are then fitted and
/// measured. Memory beyond the result: blocks of columns.
/// @param displacements (T, V, 3) float32 on the CPU
MorphBasis morph_basis(const at::Tensor& displacements, double tolerance, int64_t max_targets);

/// Named targets and their weights over time, as files hold them.
struct BlendShapes {
  std::vector<std::string> names;
  at::Tensor targets;      ///< (K, V, 3) float32, the mesh's own unit and axes
  at::Tensor weights;      ///< (T, K) float32 in [0, 1]
  double max_error = 0.0;  ///< as MorphBasis
};

/// The motion by `given` shapes, whose weights stay as they are, and by the leading components of
/// what they leave ("motion_0", ...), as many as morph_basis() needs.
/// @param given may be empty. @throws std::invalid_argument where it doesn't fit the motion, or for
/// weights outside [0, 1].
BlendShapes blend_shapes(const at::Tensor& displacements, const BlendShapes& given,
                         double tolerance, int64_t max_targets);

/// Largest distance of a vertex from its displacement over all frames.
/// @param displacements (T, V, 3), @param weights (T, K), @param targets (K, V, 3): float32.
double morph_error(const at::Tensor& displacements, const at::Tensor& weights,
                   const at::Tensor& targets);

}  // namespace freetalk::animation
