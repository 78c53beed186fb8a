#include "freetalk/geometry/robust_laplacian.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>

#include <random>

#include "../mesh/shapes.h"
#include "freetalk/geometry/operators.h"
#include "freetalk/mesh/normals.h"

namespace freetalk::geometry {
namespace {

using testing::grid;
using testing::join;
using testing::message_of;
using testing::Shape;
using testing::sphere;

/// Triangles between random points: every edge non-manifold, needles, no orientation.
Shape tangle(int num_vertices, int num_faces, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> coordinate(-1.0, 1.0);
  Shape shape{Eigen::MatrixXd(num_vertices, 3), Eigen::MatrixXi(num_faces, 3)};
  for (double& x : shape.vertices.reshaped()) x = coordinate(random);
  for (int f = 0; f < num_faces; ++f) {
    for (int c = 0; c < 3; ++c) {
      // May name a vertex twice.
      shape.faces(f, c) = static_cast<int>(random() % static_cast<unsigned>(num_vertices));
    }
  }
  return shape;
}

void expect_laplacian(const LaplacianAndMass& result, double tolerance = 1e-9) {
  const Eigen::MatrixXd dense(result.laplacian);
  const double scale = dense.cwiseAbs().maxCoeff();
  ASSERT_TRUE(dense.allFinite());
  EXPECT_LT((dense - dense.transpose()).cwiseAbs().maxCoeff(), tolerance * scale);
  EXPECT_LT(dense.rowwise().sum().cwiseAbs().maxCoeff(), tolerance * scale);
  const Eigen::MatrixXd off = dense - Eigen::MatrixXd(dense.diagonal().asDiagonal());
  // Delaunay edges weigh at least -1e-6 (the tolerance of the flips), a pair has a few of them.
  EXPECT_LT(off.maxCoeff(), 1e-5);
  EXPECT_GT(result.mass.minCoeff(), 0.0);
}

TEST(RobustLaplacian, EqualsTheCotangentLaplacianOfADelaunayMesh) {
  const Shape shape = sphere(3);
  const LaplacianAndMass robust = robust_laplacian(shape.vertices, shape.faces);
  const SparseMatrix cotan = cotan_laplacian(shape.vertices, shape.faces);
  EXPECT_LT((robust.laplacian - cotan).norm(), 1e-12 * cotan.norm());  // The same sums, rounded.
  EXPECT_NEAR(robust.mass.sum(), mesh::face_areas(shape.vertices, shape.faces).sum(), 1e-12);
}

TEST(RobustLaplacian, IsALaplacianOfAnyTriangles) {
  expect_laplacian(robust_laplacian(sphere(2).vertices, sphere(2).faces));
  expect_laplacian(robust_laplacian(grid(6).vertices, grid(6).faces));
  for (unsigned seed = 0; seed < 8; ++seed) {
    const Shape shape = tangle(12, 150, seed);
    expect_laplacian(robust_laplacian(shape.vertices, shape.faces));
  }
  Shape line = grid(5, 1.0, 0.0);
  expect_laplacian(robust_laplacian(line.vertices, line.faces));
}

TEST(RobustLaplacian, IgnoresTheOrientationOfFaces) {
  Shape shape = grid(7, 1.0, 0.3);
  shape.vertices.col(2) = 0.2 * shape.vertices.col(0).array().square();
  const LaplacianAndMass expected = robust_laplacian(shape.vertices, shape.faces);
  for (Eigen::Index f = 0; f < shape.faces.rows(); f += 2) {
    std::swap(shape.faces(f, 0), shape.faces(f, 1));
  }
  const LaplacianAndMass turned = robust_laplacian(shape.vertices, shape.faces);
  EXPECT_LT((turned.laplacian - expected.laplacian).norm(), 1e-12 * expected.laplacian.norm());
  EXPECT_LT((turned.mass - expected.mass).norm(), 1e-12 * expected.mass.norm());
}

TEST(RobustLaplacian, ScalesExactlyByPowersOfTwo) {
  const Shape shape = tangle(20, 60, 3);
  const LaplacianAndMass small = robust_laplacian(shape.vertices, shape.faces);
  for (const int exponent : {-500, 10, 480}) {
    const double scale = std::ldexp(1.0, exponent);
    const LaplacianAndMass large = robust_laplacian(scale * shape.vertices, shape.faces);
    EXPECT_EQ((large.laplacian - small.laplacian).norm(), 0.0);
    EXPECT_EQ(large.mass, scale * (scale * small.mass));
  }
}

TEST(RobustLaplacian, ThreeSheetsOnAnEdgeConductAsThreeWings) {
  // Three unit right triangles on the edge 0-1, at 120 degrees: Delaunay, so each wing adds its
  // cotangents, whatever the order around the edge.
  Eigen::MatrixXd points(5, 3);
  points << 0, 0, 0, 0, 0, 1, 1, 0, 0, -0.5, std::sqrt(0.75), 0, -0.5, -std::sqrt(0.75), 0;
  Eigen::MatrixXi faces(3, 3);
  faces << 0, 1, 2, 1, 0, 3, 0, 1, 4;
  const LaplacianAndMass result = robust_laplacian(points, faces);
  EXPECT_NEAR(result.laplacian.coeff(0, 1), -1.5, 1e-12);
  EXPECT_NEAR(result.laplacian.coeff(0, 2), -0.5, 1e-12);
  EXPECT_NEAR(result.laplacian.coeff(1, 2), 0.0, 1e-12);
  EXPECT_NEAR(result.mass.sum(), 1.5, 1e-12);
}

TEST(RobustLaplacian, KeepsUnreferencedVerticesApart) {
  Shape shape = grid(4);
  shape.vertices.conservativeResize(17, 3);
  shape.vertices.row(16) << 5, 5, 5;
  const LaplacianAndMass result = robust_laplacian(shape.vertices, shape.faces);
  EXPECT_EQ(result.laplacian.coeff(16, 16), 1.0);
  EXPECT_NEAR(result.mass[16], 1e-3 * result.mass.head(16).minCoeff(), 1e-15);
}

TEST(RobustLaplacian, RefusesWhatHasNoExtent) {
  const Shape shape = grid(3);
  const Eigen::MatrixXd point = Eigen::MatrixXd::Zero(9, 3);
  EXPECT_NE(message_of([&] { robust_laplacian(point, shape.faces); }).find("length zero"),
            std::string::npos);
  EXPECT_NE(message_of([&] {
              robust_laplacian(shape.vertices, Eigen::MatrixXi(0, 3));
            }).find("at least one face"),
            std::string::npos);
  EXPECT_NE(message_of([&] {
              robust_laplacian(shape.vertices.topRows(4), shape.faces);
            }).find("within 0 .. 3"),
            std::string::npos);
}

TEST(PointCloudLaplacian, CoversASphereAboutOnceAndFollowsAMotion) {
  const Shape shape = sphere(4);
  const LaplacianAndMass result = point_cloud_laplacian(shape.vertices);
  EXPECT_NEAR(result.mass.sum(), 4.0 * M_PI, 0.02 * 4.0 * M_PI);  // Flat triangles: 1 % short.
  // Random points: those of the subdivided octahedron lie on circles, where rounding decides.
  Eigen::MatrixXd points = tangle(600, 1, 5).vertices.rowwise().normalized();
  const LaplacianAndMass before = point_cloud_laplacian(points, kMollifyFactor, 20);
  const Eigen::Matrix3d turn(Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()));
  points = (points * turn).rowwise() + Eigen::RowVector3d(30.0, -20.0, 10.0);
  const LaplacianAndMass after = point_cloud_laplacian(points, kMollifyFactor, 20);
  // Subtracting coordinates near 30 costs two digits of the lengths.
  EXPECT_LT((after.laplacian - before.laplacian).norm(), 1e-9 * before.laplacian.norm());
}

TEST(PointCloudLaplacian, RefusesTooFewPoints) {
  const Shape shape = grid(3);
  EXPECT_NE(message_of([&] {
              point_cloud_laplacian(shape.vertices, kMollifyFactor, 9);
            }).find("num_neighbors"),
            std::string::npos);
}

TEST(OrientNormals, TurnsThoseOfASphereOutwards) {
  const Shape shape = sphere(4);
  PointCloudTriangles cloud = triangulate_point_cloud(shape.vertices, 12);
  orient_normals(shape.vertices, cloud.neighbors, cloud.normals);
  EXPECT_GT((cloud.normals.array() * shape.vertices.array()).rowwise().sum().minCoeff(), 0.9);
}

TEST(SurfaceOperators, OfTheRobustLaplacianHaveItsSpectrum) {
  OperatorOptions options;
  options.k_eig = 9;
  options.laplacian = "robust";
  const Shape shape = sphere(4);
  for (const bool cloud : {false, true}) {
    const SurfaceOperators operators =
        surface_operators(shape.vertices, cloud ? Eigen::MatrixXi(0, 3) : shape.faces, options);
    const double* evals = operators.evals.data_ptr<double>();
    EXPECT_NEAR(evals[0], 0.0, 1e-5);  // 1e-8 is added to the diagonal.
    // l (l + 1) with multiplicity 2 l + 1; linear elements at this resolution are 1-2 % off.
    for (int i = 1; i < 4; ++i) EXPECT_NEAR(evals[i], 2.0, 0.05) << cloud;
    for (int i = 4; i < 9; ++i) EXPECT_NEAR(evals[i], 6.0, 0.2) << cloud;
    EXPECT_TRUE(operators.gradients.values.isfinite().all().item<bool>());
  }
}

}  // namespace
}  // namespace freetalk::geometry
