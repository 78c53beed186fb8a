// Operators of point clouds.
#pragma once

#include <Eigen/Core>

#include <functional>
#include <string>

#include "freetalk/geometry/operators.h"

namespace freetalk::geometry {

/// Operators of points without faces: the robust Laplacian of their neighbourhoods of 30 points
/// (all others if there are fewer), normals of those planes turned alike, gradients along the
/// triangles.
/// @param progress see surface_operators.
/// @throws std::invalid_argument for fewer than four points, or all points in one place.
SurfaceOperators point_cloud_operators(const Eigen::MatrixXd& points,
                                       const OperatorOptions& options, const std::string& name,
                                       const std::function<void(double)>& progress = {});

}  // namespace freetalk::geometry
