// Which lip a landmark of closed lips lies on.
#pragma once

#include <Eigen/Core>

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

}  // namespace freetalk::stm
