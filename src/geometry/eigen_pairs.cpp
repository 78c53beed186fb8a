#include <Eigen/Eigenvalues>

#include <algorithm>
#include <numeric>
#include <vector>

#include "eigen_problem.h"

namespace freetalk::geometry {

EigenPairs dense_eigenpairs(const EigenProblem& problem, int64_t count) {
  const Eigen::VectorXd inverse_root = problem.mass.cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd matrix =
      inverse_root.asDiagonal() * Eigen::MatrixXd(problem.laplacian) * inverse_root.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(matrix);
  return {solver.eigenvalues().head(count),
          inverse_root.asDiagonal() * solver.eigenvectors().leftCols(count)};
}

void sort_ascending(EigenPairs& pairs) {
  std::vector<Eigen::Index> order(static_cast<size_t>(pairs.evals.size()));
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(),
                   [&](Eigen::Index a, Eigen::Index b) { return pairs.evals[a] < pairs.evals[b]; });
  pairs.evals = pairs.evals(order).eval();
  pairs.evecs = pairs.evecs(Eigen::all, order).eval();
}

EigenPairs first_pairs(EigenPairs pairs, int64_t count) {
  if (pairs.evals.size() == count) return pairs;
  return {pairs.evals.head(count), pairs.evecs.leftCols(count)};
}

int64_t widest_gap(const Eigen::VectorXd& evals, int64_t first) {
  int64_t widest = evals.size() - 1;
  for (int64_t i = first; i < evals.size(); ++i) {
    if (evals[i] - evals[i - 1] > evals[widest] - evals[widest - 1]) widest = i;
  }
  return widest;
}

}  // namespace freetalk::geometry
