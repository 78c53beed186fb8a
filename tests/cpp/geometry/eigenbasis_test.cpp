#include "freetalk/geometry/eigenbasis.h"

#include <ATen/Parallel.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <vector>

#include "../mesh/shapes.h"
#include "freetalk/geometry/surface.h"

namespace freetalk::geometry {
namespace {

using testing::grid;
using testing::join;
using testing::message_of;
using testing::Shape;
using testing::sphere;
using testing::toy_head;

struct Matrices {
  SparseMatrix laplacian;
  Eigen::VectorXd mass;
};

Matrices matrices_of(const Shape& shape) {
  return {cotan_laplacian(shape.vertices, shape.faces), lumped_mass(shape.vertices, shape.faces)};
}

Eigenbasis solve(const Matrices& m, int64_t k, const std::string& solver = "auto",
                 double tolerance = 1e-6) {
  return eigenbasis(m.laplacian, m.mass, EigenbasisOptions{k, tolerance, solver}, "bust");
}

/// `arms` equal chains of `length` vertices that meet in vertex 0, unit weights and masses: every
/// eigenvalue of a chain held at one end and free at the other is there arms - 1 times.
Matrices star(int arms, int length) {
  std::vector<Eigen::Triplet<double>> entries;
  for (int arm = 0; arm < arms; ++arm) {
    for (int i = 0; i < length; ++i) {
      const int here = 1 + arm * length + i;
      const int before = i == 0 ? 0 : here - 1;
      entries.insert(
          entries.end(),
          {{here, here, 1.0}, {before, before, 1.0}, {here, before, -1.0}, {before, here, -1.0}});
    }
  }
  const int size = 1 + arms * length;
  SparseMatrix laplacian(size, size);
  laplacian.setFromTriplets(entries.begin(), entries.end());
  return {laplacian, Eigen::VectorXd::Ones(size)};
}

TEST(Eigenbasis, OfTheBlockSolverIsThatOfTheReference) {
  const Matrices m = matrices_of(toy_head(4));  // 1026 vertices
  const Eigenbasis block = solve(m, 40, "block");
  const Eigenbasis reference = solve(m, 40, "spectra");
  // Residuals are below 1e-7, eigenvalues are off by the square of that.
  EXPECT_TRUE(block.evals.tail(39).isApprox(reference.evals.tail(39), 1e-10));
  // The heat kernel ignores signs and turns within an eigenspace.
  const double time = 1.0 / reference.evals[20];
  const auto kernel = [&](const Eigenbasis& basis) -> Eigen::MatrixXd {
    const Eigen::VectorXd decay = (-time * basis.evals).array().exp();
    return basis.evecs * decay.asDiagonal() * basis.evecs.transpose();
  };
  EXPECT_TRUE(kernel(block).isApprox(kernel(reference), 1e-7));
}

TEST(Eigenbasis, OfEverySolverIsOrthonormalWithTheResidualsItStates) {
  const Matrices m = matrices_of(toy_head(3));  // 258 vertices
  SparseMatrix identity(m.mass.size(), m.mass.size());
  identity.setIdentity();
  const SparseMatrix laplacian = m.laplacian + 1e-8 * identity;
  for (const char* solver : {"block", "spectra", "dense"}) {
    const Eigenbasis basis = solve(m, 30, solver);
    const Eigen::MatrixXd gram = basis.evecs.transpose() * m.mass.asDiagonal() * basis.evecs;
    EXPECT_TRUE(gram.isIdentity(1e-9)) << solver;  // The reference's accuracy, 1e-10, and a margin.
    EXPECT_TRUE(std::is_sorted(basis.evals.begin(), basis.evals.end())) << solver;
    EXPECT_LE(basis.residuals.maxCoeff(), 1e-6) << solver;
    for (int i = 1; i < 30; ++i) {
      const Eigen::VectorXd weighted = m.mass.cwiseProduct(basis.evecs.col(i));
      const double scale =
          std::max(basis.evals[i], 4.0 * std::numbers::pi / m.mass.sum()) * weighted.norm() +
          1e-8 * laplacian.diagonal().maxCoeff() * basis.evecs.col(i).norm();
      const double residual =
          (laplacian * basis.evecs.col(i) - basis.evals[i] * weighted).norm() / scale;
      // Both are differences of numbers of size one that cancel to 1e-8: alike to its rounding.
      EXPECT_NEAR(basis.residuals[i], residual, 1e-3 * residual + 1e-13) << solver << " " << i;
    }
  }
}

TEST(Eigenbasis, FindsMoreCopiesOfAnEigenvalueThanABlockHas) {
  const Matrices m = star(25, 24);  // 601 vertices in one part; eigenvalues 24 times
  const Eigenbasis basis = solve(m, 60, "block");
  const Eigenbasis dense = solve(m, 60, "dense");
  EXPECT_LT((basis.evals - dense.evals).cwiseAbs().maxCoeff(), 1e-9);
  // Chains of 24 held at one end: 2 - 2 cos((2 n - 1) pi / 49), plus the 1e-8 on the diagonal.
  const double first = 2.0 - 2.0 * std::cos(std::numbers::pi / 49.0) + 1e-8;
  for (int i = 1; i <= 24; ++i) EXPECT_NEAR(basis.evals[i], first, 1e-9) << i;
  EXPECT_GT(basis.evals[25], 1.5 * first);
}

TEST(Eigenbasis, OfPartsOfManySizesIsTheirUnion) {
  Shape shape = join(join(sphere(3), grid(12, 0.2, 0.2)), join(sphere(2), grid(2)));
  shape.vertices.conservativeResize(shape.vertices.rows() + 3, 3);
  shape.vertices.bottomRows(3).setConstant(5.0);  // unreferenced: parts of one vertex
  const Matrices m = matrices_of(shape);
  const Eigenbasis basis = solve(m, 50);
  const Eigenbasis dense = solve(m, 50, "dense");
  const Eigenbasis alone = solve(matrices_of(sphere(3)), 20);
  EXPECT_LT((basis.evals - dense.evals).cwiseAbs().maxCoeff(), 1e-9 * dense.evals[49]);
  EXPECT_LE(basis.residuals.maxCoeff(), 1e-6);
  int zeros = 0;
  for (int i = 0; i < 50; ++i) zeros += basis.evals[i] < 1e-4 ? 1 : 0;
  EXPECT_EQ(zeros, 4);
  const Eigen::MatrixXd gram = basis.evecs.transpose() * m.mass.asDiagonal() * basis.evecs;
  EXPECT_TRUE(gram.isIdentity(1e-9));
  // After the zeros the three of the coarse sphere, which are lower, and the three of the fine one.
  // The mass of the whole has a share of the mean that is of another size.
  for (int i = 1; i <= 3; ++i) EXPECT_NEAR(basis.evals[6 + i], alone.evals[i], 1e-6) << i;
}

TEST(Eigenbasis, OfAHundredEqualPartsHasAZeroForEach) {
  Shape shape = grid(4);
  for (int i = 1; i < 100; ++i) shape = join(shape, grid(4));
  const Eigenbasis basis = solve(matrices_of(shape), 150);
  EXPECT_LT(basis.evals[99], 1e-4);
  EXPECT_GT(basis.evals[100], 1.0);
  EXPECT_NEAR(basis.evals[149], basis.evals[100], 1e-9 * basis.evals[100]);
}

TEST(Eigenbasis, HasTheSameBitsForAnyNumberOfThreads) {
  const Matrices m = matrices_of(toy_head(5));  // 4098 vertices
  const int before = at::get_num_threads();
  std::vector<Eigenbasis> bases;
  for (const int threads : {1, 2, 5}) {
    at::set_num_threads(threads);
    bases.push_back(solve(m, 48));
  }
  at::set_num_threads(before);
  for (const Eigenbasis& basis : bases) {
    EXPECT_TRUE((basis.evals.array() == bases[0].evals.array()).all());
    EXPECT_TRUE((basis.evecs.array() == bases[0].evecs.array()).all());
  }
}

TEST(Eigenbasis, OfNeedleLikeFacesConverges) {
  Shape shape = toy_head(4);
  for (int v = 0; v < 40; ++v) {  // Neighbours almost in one place: weights of 1e5 and more.
    const int f = 17 * v;
    shape.vertices.row(shape.faces(f, 0)) = (1.0 - 1e-7) * shape.vertices.row(shape.faces(f, 1)) +
                                            1e-7 * shape.vertices.row(shape.faces(f, 0));
  }
  const Eigenbasis basis = solve(matrices_of(shape), 40);
  EXPECT_LE(basis.residuals.maxCoeff(), 1e-6);
  EXPECT_TRUE(basis.evecs.allFinite());
}

TEST(Eigenbasis, OfFewPairsOfManyVerticesConverges) {
  const Matrices m = matrices_of(sphere(5));
  for (const int64_t k : {1, 2, 9}) {
    const Eigenbasis basis = solve(m, k, "block");
    EXPECT_EQ(basis.evals.size(), k);
    EXPECT_LE(basis.residuals.maxCoeff(), 1e-6);
    EXPECT_LT(basis.evals[0], 1e-3);
    // Linear elements on edges h of 0.05 are off by some h^2 l (l + 1) / 12, relatively.
    if (k == 9) {
      EXPECT_NEAR(basis.evals[8], 6.0, 0.02);
    }
  }
}

TEST(Eigenbasis, ReportsItsProgressAndStopsWhenToldTo) {
  const Matrices m = matrices_of(join(toy_head(4), sphere(4)));
  std::vector<double> shares;
  eigenbasis(m.laplacian, m.mass, {30, 1e-6, "auto"}, "bust",
             [&](double share) { shares.push_back(share); });
  ASSERT_GT(shares.size(), 10u);
  EXPECT_TRUE(std::is_sorted(shares.begin(), shares.end()));
  EXPECT_GT(shares.front(), 0.0);
  EXPECT_EQ(shares.back(), 1.0);
  const auto stop = [](double) { throw std::runtime_error("stopped"); };
  EXPECT_EQ(message_of([&] {
              eigenbasis(m.laplacian, m.mass, {30, 1e-6, "auto"}, "bust", stop);
            }),
            "stopped");
}

TEST(Eigenbasis, NamesTheMeshWhenItDoesNotConverge) {
  const Matrices m = matrices_of(toy_head(3));  // 258 vertices
  for (const char* solver : {"block", "spectra"}) {
    const std::string message = message_of([&] { solve(m, 8, solver, 1e-18); });
    EXPECT_NE(message.find("bust did not converge"), std::string::npos) << solver << message;
  }
}

TEST(Eigenbasis, RefusesWhatItCannotSolve) {
  const Matrices m = matrices_of(grid(4));
  EXPECT_EQ(solve(m, 16).evals.size(), 16);
  EXPECT_NE(message_of([&] { solve(m, 17); }).find("k_eig <= 16"), std::string::npos);
  EXPECT_THROW(solve(m, 0), std::invalid_argument);
  EXPECT_THROW(solve(m, 4, "magic"), std::invalid_argument);
  EXPECT_THROW(solve(m, 4, "auto", 0.0), std::invalid_argument);
  EXPECT_THROW(solve({m.laplacian, m.mass.head(15)}, 4), std::invalid_argument);
  EXPECT_THROW(solve({m.laplacian, Eigen::VectorXd::Zero(16)}, 4), std::invalid_argument);
  Matrices broken = m;
  broken.laplacian.coeffRef(3, 3) = std::nan("");
  EXPECT_NE(message_of([&] { solve(broken, 4); }).find("bust needs a finite"), std::string::npos);
}

}  // namespace
}  // namespace freetalk::geometry
