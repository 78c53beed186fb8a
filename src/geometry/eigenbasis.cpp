#include "freetalk/geometry/eigenbasis.h"

#include <Spectra/SymEigsSolver.h>
#include <Eigen/Eigenvalues>
#include <Eigen/SparseCholesky>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <optional>

#include "freetalk/core/error.h"

namespace freetalk::geometry {
namespace {

using Factor = Eigen::SimplicialLDLT<SparseMatrix>;

/// y = P D^1/2 (L + s D)^-1 D^1/2 P x, P the projection onto the complement of `known` (in the
/// D^1/2 metric).
class ShiftInvertOperator {
 public:
  using Scalar = double;

  ShiftInvertOperator(const Factor& factor, const Eigen::VectorXd& root_mass,
                      const Eigen::MatrixXd& known)
      : factor_(factor), root_mass_(root_mass), known_(known) {}

  Eigen::Index rows() const { return root_mass_.size(); }
  Eigen::Index cols() const { return root_mass_.size(); }

  void perform_op(const double* in, double* out) const {
    const Eigen::Index n = rows();
    Eigen::VectorXd x = Eigen::Map<const Eigen::VectorXd>(in, n);
    project(x);
    x.array() *= root_mass_.array();
    Eigen::VectorXd y = factor_.solve(x);
    y.array() *= root_mass_.array();
    project(y);
    Eigen::Map<Eigen::VectorXd>(out, n) = y;
  }

 private:
  void project(Eigen::VectorXd& x) const {
    if (known_.cols() > 0) x -= known_ * (known_.transpose() * x);
  }

  const Factor& factor_;
  const Eigen::VectorXd& root_mass_;
  const Eigen::MatrixXd& known_;
};

struct Problem {
  SparseMatrix laplacian;  // L + 1e-8 I
  const Eigen::VectorXd& mass;
  Eigen::VectorXd root_mass;
  double shift = 0.0;       // s > 0: (L + s M)^-1 is applied, so the smallest come first
  double first_eval = 0.0;  // 4 pi / area, Weyl's estimate of the first
};

SparseMatrix shifted(const Problem& problem, double amount) {
  SparseMatrix matrix = problem.laplacian;
  for (Eigen::Index i = 0; i < matrix.rows(); ++i)
    matrix.coeffRef(i, i) += amount * problem.mass[i];
  return matrix;
}

Eigen::VectorXd residuals_of(const Problem& problem, const Eigenbasis& basis) {
  const Eigen::MatrixXd applied = problem.laplacian * basis.evecs;
  // Weights of needle-like faces are huge, and so is their rounding: it is no fault of the
  // eigenpair.
  const double rounding = 1e-8 * problem.laplacian.diagonal().maxCoeff();
  Eigen::VectorXd residuals(basis.evals.size());
  for (Eigen::Index i = 0; i < residuals.size(); ++i) {
    const Eigen::VectorXd weighted = problem.mass.cwiseProduct(basis.evecs.col(i));
    const double scale = std::max(std::abs(basis.evals[i]), problem.first_eval) * weighted.norm() +
                         rounding * basis.evecs.col(i).norm();
    residuals[i] = (applied.col(i) - basis.evals[i] * weighted).norm() / scale;
  }
  return residuals;
}

Eigenbasis dense_basis(const Problem& problem, int64_t k) {
  const Eigen::VectorXd inverse_root = problem.root_mass.cwiseInverse();
  const Eigen::MatrixXd matrix =
      inverse_root.asDiagonal() * Eigen::MatrixXd(problem.laplacian) * inverse_root.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(matrix);
  Eigenbasis basis;
  basis.evals = solver.eigenvalues().head(k);
  basis.evecs = inverse_root.asDiagonal() * solver.eigenvectors().leftCols(k);
  return basis;
}

/// Pairs of the complement of `known`: eigenvectors of the normalised problem (orthonormal) and
/// evals, ascending.
struct NormalizedPairs {
  Eigen::VectorXd evals;
  Eigen::MatrixXd vectors;
};

std::optional<NormalizedPairs> lanczos(const Problem& problem, const Factor& factor,
                                       const Eigen::MatrixXd& known, Eigen::Index count,
                                       Eigen::Index subspace) {
  ShiftInvertOperator op(factor, problem.root_mass, known);
  Spectra::SymEigsSolver<ShiftInvertOperator> solver(op, count, subspace);
  solver.init();
  constexpr int kMaxRestarts = 300;
  constexpr double kTolerance =
      1e-10;  // of the inverted problem; the residuals below are what is promised
  solver.compute(Spectra::SortRule::LargestAlge, kMaxRestarts, kTolerance);
  if (solver.info() != Spectra::CompInfo::Successful) return std::nullopt;
  NormalizedPairs pairs;
  pairs.evals = solver.eigenvalues().cwiseInverse().array() - problem.shift;
  pairs.vectors = solver.eigenvectors();
  return pairs;
}

/// Number of eigenvalues below `bound`, from the signs of a factorisation; -1 if it breaks down.
Eigen::Index count_below(const Problem& problem, double bound) {
  const Factor factor(shifted(problem, -bound));
  if (factor.info() != Eigen::Success) return -1;
  const Eigen::VectorXd pivots = factor.vectorD();
  if (!pivots.allFinite()) return -1;
  return (pivots.array() < 0.0).count();
}

void sort_ascending(NormalizedPairs& pairs) {
  std::vector<Eigen::Index> order(static_cast<size_t>(pairs.evals.size()));
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(),
            [&](Eigen::Index a, Eigen::Index b) { return pairs.evals[a] < pairs.evals[b]; });
  const NormalizedPairs old = pairs;
  for (size_t i = 0; i < order.size(); ++i) {
    pairs.evals[static_cast<Eigen::Index>(i)] = old.evals[order[i]];
    pairs.vectors.col(static_cast<Eigen::Index>(i)) = old.vectors.col(order[i]);
  }
}

/// The widest gap among the last few eigenvalues: a bound between two clusters, where counting is
/// safe.
Eigen::Index last_safe_count(const Eigen::VectorXd& evals) {
  const Eigen::Index count = evals.size();
  Eigen::Index best = count - 1;
  for (Eigen::Index i = std::max<Eigen::Index>(1, count - 8); i < count; ++i) {
    if (evals[i] - evals[i - 1] > evals[best] - evals[best - 1]) best = i;
  }
  return best;
}

/// Adds eigenpairs Lanczos stepped over until the count below the last agrees with Sylvester's law.
bool complete(const Problem& problem, const Factor& factor, NormalizedPairs& pairs) {
  constexpr int kMaxRounds = 8;
  for (int round = 0; round < kMaxRounds; ++round) {
    if (pairs.evals.size() < 2) return true;
    const Eigen::Index safe = last_safe_count(pairs.evals);
    const double bound = 0.5 * (pairs.evals[safe - 1] + pairs.evals[safe]);
    const Eigen::Index missing = count_below(problem, bound) - safe;
    if (missing <= 0) return true;  // Negative: rounding in a cluster at the bound, or a breakdown.
    const Eigen::Index room = problem.mass.size() - pairs.evals.size();
    const Eigen::Index extra = std::min<Eigen::Index>(missing + 2, room - 1);
    if (extra < 1) return false;
    const Eigen::Index subspace =
        std::min<Eigen::Index>(std::max<Eigen::Index>(3 * extra, 20), room);
    std::optional<NormalizedPairs> more = lanczos(problem, factor, pairs.vectors, extra, subspace);
    if (!more) return false;
    NormalizedPairs all;
    all.evals.resize(pairs.evals.size() + extra);
    all.evals << pairs.evals, more->evals;
    all.vectors.resize(problem.mass.size(), all.evals.size());
    all.vectors << pairs.vectors, more->vectors;
    sort_ascending(all);
    pairs = std::move(all);
  }
  return false;
}

}  // namespace

Eigenbasis eigenbasis(const SparseMatrix& laplacian, const Eigen::VectorXd& mass, int64_t k,
                      double tolerance, const std::string& name) {
  const Eigen::Index count = mass.size();
  FREETALK_CHECK(k >= 1, "eigenbasis of ", name, " needs at least 1 eigenpair, asked for ", k);
  FREETALK_CHECK(k <= count, "eigenbasis of ", name, " was asked for ", k,
                 " eigenpairs but the mesh has ", count, " vertices; use k_eig <= ", count);
  const double area = mass.sum();
  FREETALK_CHECK(std::isfinite(area) && mass.minCoeff() > 0.0, "eigenbasis of ", name,
                 " needs a positive mass at every vertex; the surface has no area");
  SparseMatrix identity(count, count);
  identity.setIdentity();
  const double first_eval = 4.0 * std::numbers::pi / area;
  Problem problem{laplacian + 1e-8 * identity, mass, mass.cwiseSqrt(), first_eval, first_eval};

  const auto finish = [&](Eigenbasis basis) {
    basis.residuals = residuals_of(problem, basis);
    basis.evals = basis.evals.cwiseMax(0.0);
    return basis;
  };
  constexpr Eigen::Index kDenseLimit = 400;  // Dense is faster below, and has no subspace to fit.
  if (count <= kDenseLimit || 2 * k + 2 > count) return finish(dense_basis(problem, k));

  double worst = 0.0;
  Eigen::Index subspace = std::min<Eigen::Index>(std::max<Eigen::Index>(2 * k + 1, 40), count);
  for (int attempt = 0; attempt < 3; ++attempt) {
    const Factor factor(shifted(problem, problem.shift));
    FREETALK_RUNTIME_CHECK(factor.info() == Eigen::Success, "the Laplacian of ", name,
                           " cannot be factored; repair the mesh (NaN, huge or tiny coordinates)");
    std::optional<NormalizedPairs> pairs = lanczos(problem, factor, Eigen::MatrixXd(), k, subspace);
    if (pairs) {
      sort_ascending(*pairs);
      const bool all_found = complete(problem, factor, *pairs);
      Eigenbasis basis;
      basis.evals = pairs->evals.head(k);
      basis.evecs = problem.root_mass.cwiseInverse().asDiagonal() * pairs->vectors.leftCols(k);
      basis = finish(std::move(basis));
      worst = basis.residuals.maxCoeff();
      if (all_found && worst <= tolerance) return basis;
    }
    subspace = std::min<Eigen::Index>(2 * subspace, count);
    problem.shift *= 10.0;
  }
  FREETALK_RUNTIME_CHECK(false, "the eigenbasis of ", name, " did not converge (", k,
                         " eigenpairs, largest residual ", worst,
                         "); use a smaller k_eig or repair the mesh");
  return {};
}

}  // namespace freetalk::geometry
