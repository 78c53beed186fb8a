// The inside of a mouth: a pocket sewn to the rims of a slit.
#pragma once

#include <Eigen/Core>

#include <vector>

#include "freetalk/mesh/reshaped.h"

namespace freetalk::mesh {

/// A vertex of a rim and its texture coordinate (-1: none).
struct RimVertex {
  int vertex = 0, texcoord = -1;
};

/// Adds rings of quads behind the rims, and a wall at their end.
/// @param upper, lower from the corner of the subject's right to that of the left, of the same
/// length; they share both ends. @param origin the polygon whose look the pocket has.
void sew_pocket(const std::vector<RimVertex>& upper, const std::vector<RimVertex>& lower,
                double depth, int origin, Reshaped& slit);

}  // namespace freetalk::mesh
