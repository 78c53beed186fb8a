// What the eigensolvers behind eigenbasis.h share.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "freetalk/geometry/surface.h"

namespace freetalk::geometry {

/// L phi = lambda M phi on one connected part of a mesh.
struct EigenProblem {
  SparseMatrix laplacian;  // L, positive semi-definite, every diagonal entry stored
  Eigen::VectorXd mass;    // > 0
  double first_eval;       // 4 pi / area: Weyl's estimate of the first eigenvalue
};

struct EigenRequest {
  int64_t count;     // pairs wanted
  double tolerance;  // largest residual |L phi - lambda M phi| / (max(lambda, first) |M phi|)
  double shift;      // s > 0: (L + s M)^-1 is applied, so the smallest come first
  int64_t room;      // 1: the usual subspace; 2: twice that ...
  std::string name;  // names the mesh in messages
  std::function<void(double)> progress;  // called with the finished share; may be empty
};

struct EigenPairs {
  Eigen::VectorXd evals;  // ascending
  Eigen::MatrixXd evecs;  // M-orthonormal
};

/// Both give at least `count` pairs, or nothing if they do not converge.
std::optional<EigenPairs> spectra_eigenpairs(const EigenProblem& problem,
                                             const EigenRequest& request);
std::optional<EigenPairs> block_eigenpairs(const EigenProblem& problem,
                                           const EigenRequest& request);

/// By a full decomposition.
EigenPairs dense_eigenpairs(const EigenProblem& problem, int64_t count);

/// Brings pairs into ascending order.
void sort_ascending(EigenPairs& pairs);

/// The first `count` pairs.
EigenPairs first_pairs(EigenPairs pairs, int64_t count);

/// The i in [first, evals.size()) with the widest gap between evals[i - 1] and evals[i]: counting
/// the eigenvalues below the middle of it is safe from rounding within a cluster.
int64_t widest_gap(const Eigen::VectorXd& evals, int64_t first);

}  // namespace freetalk::geometry
