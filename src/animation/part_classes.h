// What each component of a head mesh is.
#pragma once

#include <Eigen/Core>

#include <vector>

#include "freetalk/animation/parts.h"

namespace freetalk::animation {

/// Vertices with those doubled along texture seams joined. Stricter than what the operators weld
/// (mesh/weld.h): doubles count as one if they lie on open borders and their normals are within 60
/// degrees. Lips that touch may be no further apart, and joined they would not open; a seam left
/// open costs a component, no more.
struct Welded {
  std::vector<int> representative;  // (V,) first vertex at the same place
  Eigen::MatrixXi faces;            // (F, 3) over representatives
  std::vector<int> component;       // (V,)
  int num_components = 0;
};

Welded weld_seams(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces);

/// The vertices of each component.
std::vector<std::vector<int>> component_members(const Welded& welded);

/// The motion of every component; a component in the mouth on both sides of the occlusal plane
/// counts as kJaw.
std::vector<PartMotion> classify_parts(const Eigen::MatrixXd& vertices, const Welded& welded,
                                       const Eigen::MatrixXd& landmarks);

/// (V,) share of the jaw's motion: 1 in jaw parts, 0 elsewhere, between 0 and 1 near the bend of
/// parts that hold both jaws.
std::vector<float> jaw_shares(const Eigen::MatrixXd& vertices, const Welded& welded,
                              const std::vector<PartMotion>& motions,
                              const Eigen::MatrixXd& landmarks);

}  // namespace freetalk::animation
