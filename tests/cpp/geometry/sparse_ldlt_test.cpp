#include "geometry/sparse_ldlt.h"

#include <ATen/Parallel.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include <random>
#include <vector>

#include "kernels/isa.h"

namespace freetalk::geometry {
namespace {

using kernels::kBlockWidth;

/// A wavy grid's Laplacian with random weights and holes, plus `shift` on the diagonal.
SparseMatrix laplacian_of_grid(int side, double shift, unsigned seed) {
  std::mt19937 generator(seed);
  std::uniform_real_distribution<double> weight(0.5, 1.5);
  std::vector<Eigen::Triplet<double>> entries;
  const auto join = [&](int a, int b) {
    const double w = generator() % 10 == 0 ? 0.0 : weight(generator);
    entries.insert(entries.end(), {{a, b, -w}, {b, a, -w}, {a, a, w}, {b, b, w}});
  };
  for (int i = 0; i < side; ++i) {
    for (int j = 0; j < side; ++j) {
      const int at = i * side + j;
      entries.emplace_back(at, at, shift);
      if (i + 1 < side) join(at, at + side);
      if (j + 1 < side) join(at, at + 1);
      if (i + 1 < side && j + 1 < side) join(at, at + side + 1);
    }
  }
  SparseMatrix matrix(side * side, side * side);
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

Eigen::MatrixXd solve(const SparseLdlt& ldlt, const Eigen::MatrixXd& right) {
  kernels::TallBlock x(ldlt.solve_rows());
  for (Eigen::Index i = 0; i < right.rows(); ++i) {
    for (int64_t c = 0; c < kBlockWidth; ++c) x.row(ldlt.position()[i])[c] = right(i, c);
  }
  ldlt.solve(x);
  Eigen::MatrixXd result(right.rows(), kBlockWidth);
  for (Eigen::Index i = 0; i < right.rows(); ++i) {
    for (int64_t c = 0; c < kBlockWidth; ++c) result(i, c) = x.row(ldlt.position()[i])[c];
  }
  return result;
}

TEST(SparseLdlt, SolvesLikeADenseFactorAtEveryInstructionSet) {
  for (const int side : {1, 2, 7, 23}) {
    const SparseMatrix matrix = laplacian_of_grid(side, 0.1, 1);
    const Eigen::MatrixXd right = Eigen::MatrixXd::Random(side * side, kBlockWidth);
    const Eigen::MatrixXd expected = Eigen::MatrixXd(matrix).ldlt().solve(right);
    for (int level = 0; level <= static_cast<int>(kernels::best_isa()); ++level) {
      const kernels::IsaScope scope(static_cast<kernels::Isa>(level));
      SparseLdlt ldlt(matrix);
      ASSERT_TRUE(ldlt.factorize(matrix));
      // Condition numbers are below 1e2.
      EXPECT_LT((solve(ldlt, right) - expected).cwiseAbs().maxCoeff(), 1e-12) << side;
    }
  }
}

TEST(SparseLdlt, SignsOfPivotsCountEigenvaluesBelowTheShift) {
  const SparseMatrix matrix = laplacian_of_grid(12, 0.0, 2);
  const Eigen::VectorXd evals =
      Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(Eigen::MatrixXd(matrix)).eigenvalues();
  SparseLdlt ldlt(matrix);
  for (const int count : {1, 5, 40, 100}) {
    SparseMatrix shifted = matrix;
    shifted.diagonal().array() -= 0.5 * (evals[count - 1] + evals[count]);
    ASSERT_TRUE(ldlt.factorize(shifted));
    EXPECT_EQ((ldlt.pivots().array() < 0.0).count(), count);
  }
}

TEST(SparseLdlt, OfManySubtreesHasSmallResidualsAndTheSameBitsForAnyNumberOfThreads) {
  const SparseMatrix matrix = laplacian_of_grid(230, 0.01, 3);  // fronts shared between threads too
  const Eigen::MatrixXd right = Eigen::MatrixXd::Random(matrix.rows(), kBlockWidth);
  const int before = at::get_num_threads();
  std::vector<Eigen::MatrixXd> results;
  for (const int threads : {1, 2, 5}) {
    at::set_num_threads(threads);
    SparseLdlt ldlt(matrix);
    ASSERT_GT(ldlt.solve_rows(), ldlt.size());
    ASSERT_TRUE(ldlt.factorize(matrix));
    results.push_back(solve(ldlt, right));
  }
  at::set_num_threads(before);
  // Weights are about one, and rounding grows with the norm of the solution, at most 1e2 here.
  EXPECT_LT((matrix * results[0] - right).cwiseAbs().maxCoeff(), 1e-11);
  EXPECT_TRUE(results[0] == results[1]);
  EXPECT_TRUE(results[0] == results[2]);
}

TEST(SparseLdlt, SaysThatAPivotVanished) {
  SparseMatrix matrix = laplacian_of_grid(3, 0.0, 4);
  SparseLdlt ldlt(matrix);
  matrix.coeffs().setZero();
  EXPECT_FALSE(ldlt.factorize(matrix));
}

}  // namespace
}  // namespace freetalk::geometry
