// The Laplacian and mass that operator options name.
#pragma once

#include <Eigen/Core>

#include "freetalk/geometry/operators.h"
#include "freetalk/geometry/robust_laplacian.h"
#include "freetalk/geometry/surface.h"

namespace freetalk::geometry {

Regularization regularization_of(const OperatorOptions& options);

/// The mass plus 1e-8 of its mean, so that no vertex's vanishes beside the others.
Eigen::VectorXd with_floor(const Eigen::VectorXd& mass);

/// Laplacian (V, V) and mass (V,) of a mesh as `options.laplacian` says.
LaplacianAndMass laplacian_by_name(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                   const OperatorOptions& options);

}  // namespace freetalk::geometry
