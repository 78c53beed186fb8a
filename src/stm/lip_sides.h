// Which lip lies where: landmarks of closed lips, vertices.
#pragma once

#include <ATen/core/Tensor.h>
#include <Eigen/Core>

#include <array>
#include <span>
#include <vector>

#include "freetalk/geometry/kriging.h"

namespace freetalk::stm {

/// Moves landmarks of the inner lips that lie on the other lip, as guessed ones on lips that touch
/// may: from a lip's outer landmarks the way to them over the surface leads around the mouth. Lips
/// that are one skin stay as they are.
/// @param vertices (V, 3) m. @param faces (F, 3). @param landmarks, normals (68, 3).
/// @param places of the landmarks as geometry::nearest_on_surface finds them; changed.
void put_on_their_lips(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                       const Eigen::MatrixXd& landmarks, const Eigen::MatrixXd& normals,
                       geometry::SurfacePoints& places);

/// (V,) whether a vertex belongs to the upper side of a gap: an upper landmark of its pairs has
/// more to say there than any lower one. @param weights (V, 68) of the landmarks on the surface,
/// float32, CPU. @param pairs upper and lower landmarks, such as core::kInnerLips.
std::vector<bool> upper_side(const at::Tensor& weights, std::span<const std::array<int, 2>> pairs);

}  // namespace freetalk::stm
