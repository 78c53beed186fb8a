// Gives operators what lives on their faces, to be computed when first asked for.
#pragma once

#include "freetalk/geometry/operators.h"

namespace freetalk::geometry {

/// @param welded coincident vertices count as one.
void attach_faces(SurfaceOperators& operators, const Eigen::MatrixXd& vertices,
                  const Eigen::MatrixXi& faces, bool welded);

}  // namespace freetalk::geometry
