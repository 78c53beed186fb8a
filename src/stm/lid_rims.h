// Landmarks of eyes on the rims of the lids.
#pragma once

#include <Eigen/Core>

#include "freetalk/geometry/kriging.h"

namespace freetalk::stm {

/// Moves the landmarks of eyes that are open, guessed from another face, to where the eyes are: the
/// lids' to the rims, the corners' to the ends of the opening. Eyes without an opening near the
/// guess stay as they are.
/// @param vertices (V, 3) m, canonical frame. @param faces (F, 3). @param landmarks (68, 3).
/// @param places of the landmarks as geometry::nearest_on_surface finds them; changed.
void put_on_their_lids(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                       const Eigen::MatrixXd& landmarks, geometry::SurfacePoints& places);

}  // namespace freetalk::stm
