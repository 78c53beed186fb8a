#include <Eigen/Core>

#include <algorithm>

#include "block_lanczos.h"
#include "eigen_problem.h"
#include "freetalk/core/error.h"
#include "shifted_factor.h"

namespace freetalk::geometry {
namespace {

constexpr int64_t kGuard = 8;  // Ritz values beyond the wanted, among which a gap is looked for.

EigenPairs joined(const EigenPairs& a, EigenPairs b) {
  if (a.evals.size() == 0) return b;
  EigenPairs all;
  all.evals.resize(a.evals.size() + b.evals.size());
  all.evals << a.evals, b.evals;
  all.evecs.resize(a.evecs.rows(), all.evals.size());
  all.evecs << a.evecs, b.evecs;
  sort_ascending(all);
  return all;
}

/// How many eigenpairs below the gap after the first `count` were stepped over. `beyond` are Ritz
/// values above all of `found`.
int64_t num_missing(ShiftedFactor& factor, const Eigen::VectorXd& found,
                    const Eigen::VectorXd& beyond, int64_t count) {
  Eigen::VectorXd evals(found.size() + beyond.size());
  evals << found, beyond;
  std::sort(evals.begin(), evals.end());
  if (evals.size() <= count) return 0;  // All eigenvalues there are.
  const int64_t gap = widest_gap(evals, count);
  const double bound = 0.5 * (evals[gap - 1] + evals[gap]);
  // Rounding at the bound may also give too few, and a pivot may vanish: neither says that
  // something is missing.
  if (!factor.factorize(-bound)) return 0;
  const int64_t held = (found.array() < bound).count();
  const int64_t there = factor.num_negative();
  return there > gap ? there - held : 0;
}

}  // namespace

std::optional<EigenPairs> block_eigenpairs(const EigenProblem& problem,
                                           const EigenRequest& request) {
  const int64_t size = problem.mass.size();
  ShiftedFactor factor(problem.laplacian, problem.mass);
  EigenPairs found{Eigen::VectorXd(), Eigen::MatrixXd(size, 0)};
  int64_t wanted = request.count;
  constexpr int kMaxRounds = 8;
  for (int round = 0; round < kMaxRounds; ++round) {
    FREETALK_RUNTIME_CHECK(factor.factorize(request.shift), "the Laplacian of ", request.name,
                           " cannot be factored; repair the mesh (NaN, huge or tiny coordinates)");
    BlockLanczos lanczos(factor, problem.mass, request.shift, found.evecs);
    const int64_t most = request.room * (3 * block_lanczos_dimension(wanted) / 2 + 64);
    // A tenth of the tolerance: an eigenvector's own error is its residual over a gap.
    if (!lanczos.run(wanted, 0.1 * request.tolerance, problem.first_eval,
                     std::min(most, size - found.evals.size()),
                     round == 0 ? request.progress : nullptr)) {
      return std::nullopt;
    }
    const Eigen::VectorXd evals = lanczos.evals(wanted + kGuard);
    found = joined(found, {evals.head(wanted), lanczos.evecs(wanted)});
    wanted = num_missing(factor, found.evals, evals.tail(evals.size() - wanted), request.count);
    if (wanted == 0) return found;
  }
  return std::nullopt;
}

}  // namespace freetalk::geometry
