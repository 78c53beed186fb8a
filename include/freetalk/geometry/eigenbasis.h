// The k smallest eigenpairs of L phi = lambda M phi, M diagonal, in double.
//
// What is solved is L + 1e-8 I, part by part of the mesh (the parts' problems are independent, and
// each has a zero eigenvalue of its own). Three solvers:
//   "dense"    a full decomposition, for small parts and where k is near V;
//   "spectra"  the reference: implicitly restarted shift-invert Lanczos of the Spectra library;
//   "block"    shift-invert block Lanczos (block_lanczos.h), several times as fast on large meshes.
// Lanczos may step over copies of a repeated eigenvalue (a sphere), so the eigenvalues below the
// last are counted from the signs of a factorisation (Sylvester's law of inertia) and missing ones
// are searched for in the complement of those found.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <functional>
#include <string>

#include "freetalk/geometry/surface.h"

namespace freetalk::geometry {

struct EigenbasisOptions {
  int64_t k = 128;              // K, number of pairs; 1 .. V
  double tolerance = 1e-6;      // largest residual accepted
  std::string solver = "auto";  // "auto" (by size), "block", "spectra", "dense"

  template <class Visitor>
  void fields(Visitor& visit) {
    visit("k", k);
    visit("tolerance", tolerance);
    visit("solver", solver);
  }
  void check() const;
};

struct Eigenbasis {
  Eigen::VectorXd evals;  ///< (K,) ascending, >= 0, 1 / length^2
  Eigen::MatrixXd evecs;  ///< (V, K), evecs^T M evecs = I
  /// (K,) |L phi - lambda M phi| / (max(lambda, 4 pi / area) |M phi| + 1e-8 max(L) |phi|):
  /// relative, with Weyl's first eigenvalue and the rounding of the largest weight as floors.
  Eigen::VectorXd residuals;
};

/// The same bits for any number of threads. About 8 V (2.5 K + 17 sqrt(K)) bytes of memory.
/// @param laplacian (V, V) symmetric, positive semi-definite; 1e-8 is added to its diagonal.
/// @param mass (V,) > 0.
/// @param name names the mesh in messages.
/// @param progress called with the finished share in (0, 1]; may throw to stop.
/// @throws std::invalid_argument if k is out of range or sizes differ; std::runtime_error naming
///   the mesh if a larger shift and subspace do not converge either.
Eigenbasis eigenbasis(const SparseMatrix& laplacian, const Eigen::VectorXd& mass,
                      const EigenbasisOptions& options = {}, const std::string& name = "mesh",
                      const std::function<void(double)>& progress = {});

}  // namespace freetalk::geometry
