// The reference solver: shift-invert Lanczos (Spectra) on D^-1 L D^-1, D = M^1/2, one vector at a
// time.
#include <Spectra/SymEigsSolver.h>
#include <Eigen/SparseCholesky>

#include <algorithm>

#include "eigen_problem.h"
#include "freetalk/core/error.h"

namespace freetalk::geometry {
namespace {

using Factor = Eigen::SimplicialLDLT<SparseMatrix>;

/// y = P D (L + s M)^-1 D P x, P the projection onto the complement of `known` (orthonormal).
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

SparseMatrix with_shift(const EigenProblem& problem, double amount) {
  SparseMatrix matrix = problem.laplacian;
  matrix.diagonal() += amount * problem.mass;
  return matrix;
}

/// Pairs of the complement of `known`, of the normalised problem (vectors orthonormal).
std::optional<EigenPairs> lanczos(const Factor& factor, const Eigen::VectorXd& root_mass,
                                  double shift, const Eigen::MatrixXd& known, Eigen::Index count,
                                  Eigen::Index subspace) {
  ShiftInvertOperator op(factor, root_mass, known);
  Spectra::SymEigsSolver<ShiftInvertOperator> solver(op, count, subspace);
  solver.init();
  constexpr int kMaxRestarts = 300;
  constexpr double kTolerance = 1e-10;  // Of the inverted problem; the caller checks residuals.
  solver.compute(Spectra::SortRule::LargestAlge, kMaxRestarts, kTolerance);
  if (solver.info() != Spectra::CompInfo::Successful) return std::nullopt;
  return EigenPairs{solver.eigenvalues().cwiseInverse().array() - shift, solver.eigenvectors()};
}

/// Number of eigenvalues below `bound`, from the signs of a factorisation; -1 if it breaks down.
Eigen::Index count_below(const EigenProblem& problem, double bound) {
  const Factor factor(with_shift(problem, -bound));
  if (factor.info() != Eigen::Success) return -1;
  const Eigen::VectorXd pivots = factor.vectorD();
  if (!pivots.allFinite()) return -1;
  return (pivots.array() < 0.0).count();
}

/// Adds eigenpairs Lanczos stepped over until the count below the last agrees with Sylvester's law.
bool complete(const EigenProblem& problem, const Factor& factor, const Eigen::VectorXd& root_mass,
              double shift, EigenPairs& pairs) {
  constexpr int kMaxRounds = 8;
  for (int round = 0; round < kMaxRounds; ++round) {
    const Eigen::Index count = pairs.evals.size();
    if (count < 2) return true;
    const int64_t safe = widest_gap(pairs.evals, std::max<Eigen::Index>(1, count - 8));
    const double bound = 0.5 * (pairs.evals[safe - 1] + pairs.evals[safe]);
    const Eigen::Index missing = count_below(problem, bound) - safe;
    if (missing <= 0) return true;  // Negative: rounding in a cluster at the bound, or a breakdown.
    const Eigen::Index room = problem.mass.size() - count;
    const Eigen::Index extra = std::min<Eigen::Index>(missing + 2, room - 1);
    if (extra < 1) return false;
    const Eigen::Index subspace =
        std::min<Eigen::Index>(std::max<Eigen::Index>(3 * extra, 20), room);
    const auto more = lanczos(factor, root_mass, shift, pairs.evecs, extra, subspace);
    if (!more) return false;
    EigenPairs all;
    all.evals.resize(count + extra);
    all.evals << pairs.evals, more->evals;
    all.evecs.resize(problem.mass.size(), count + extra);
    all.evecs << pairs.evecs, more->evecs;
    sort_ascending(all);
    pairs = std::move(all);
  }
  return false;
}

}  // namespace

std::optional<EigenPairs> spectra_eigenpairs(const EigenProblem& problem,
                                             const EigenRequest& request) {
  const Eigen::Index size = problem.mass.size();
  const Eigen::VectorXd root_mass = problem.mass.cwiseSqrt();
  const Factor factor(with_shift(problem, request.shift));
  FREETALK_RUNTIME_CHECK(factor.info() == Eigen::Success, "the Laplacian of ", request.name,
                         " cannot be factored; repair the mesh (NaN, huge or tiny coordinates)");
  const Eigen::Index subspace = std::min<Eigen::Index>(
      request.room * std::max<Eigen::Index>(2 * request.count + 1, 40), size);
  auto pairs =
      lanczos(factor, root_mass, request.shift, Eigen::MatrixXd(), request.count, subspace);
  if (!pairs) return std::nullopt;
  sort_ascending(*pairs);
  if (!complete(problem, factor, root_mass, request.shift, *pairs)) return std::nullopt;
  pairs->evecs = (root_mass.cwiseInverse().asDiagonal() * pairs->evecs).eval();
  return pairs;
}

}  // namespace freetalk::geometry
