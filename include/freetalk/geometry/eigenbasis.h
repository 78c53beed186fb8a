// The k smallest eigenpairs of L phi = lambda M phi, M diagonal.
//
// Shift-invert Lanczos (Spectra) on D^-1/2 (L + 1e-8 I) D^-1/2, D = M, in double. A single-vector
// Lanczos may step over copies of a repeated eigenvalue (two equal eyeballs, a sphere), so the
// number of eigenvalues below the last is counted from the signs of a factorisation (Sylvester's
// law of inertia) and missing ones are searched for in the complement of those found.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <string>

#include "freetalk/geometry/surface.h"

namespace freetalk::geometry {

struct Eigenbasis {
  Eigen::VectorXd evals;  ///< (K,) ascending, >= 0, 1 / length^2
  Eigen::MatrixXd evecs;  ///< (V, K), evecs^T M evecs = I
  /// (K,) |L phi - lambda M phi| / (max(lambda, 4 pi / area) |M phi| + 1e-8 max(L) |phi|):
  /// relative, with Weyl's first eigenvalue and the rounding of the largest weight as floors.
  Eigen::VectorXd residuals;
};

/// @param laplacian (V, V) positive semi-definite; 1e-8 is added to its diagonal.
/// @param mass (V,) > 0.
/// @param k number of pairs, 1 <= k <= V.
/// @param tolerance largest residual accepted.
/// @param name names the mesh in messages.
/// @throws std::invalid_argument if k is out of range; std::runtime_error naming the mesh if a
/// larger
///   subspace does not converge either.
Eigenbasis eigenbasis(const SparseMatrix& laplacian, const Eigen::VectorXd& mass, int64_t k,
                      double tolerance = 1e-6, const std::string& name = "mesh");

}  // namespace freetalk::geometry
