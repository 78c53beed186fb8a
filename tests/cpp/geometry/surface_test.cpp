#include "freetalk/geometry/surface.h"
#include "freetalk/mesh/components.h"
#include "freetalk/mesh/normals.h"

#include <gtest/gtest.h>

#include <random>

#include "../mesh/shapes.h"

namespace freetalk::geometry {
namespace {

using testing::grid;
using testing::join;
using testing::Shape;
using testing::sphere;

TEST(LumpedMass, SumsToTheArea) {
  const Shape shape = grid(9, 2.0, 3.0);
  EXPECT_NEAR(mesh::face_areas(shape.vertices, shape.faces).sum(), 6.0, 1e-12);
  // 1e-8 of the mean mass is added to every vertex.
  EXPECT_NEAR(lumped_mass(shape.vertices, shape.faces).sum(), 6.0, 6.0 * 2e-8);
}

TEST(VertexNormals, PointOutOfASphere) {
  const Shape shape = sphere(3);
  const Eigen::MatrixXd normals = mesh::vertex_normals(shape.vertices, shape.faces);
  for (Eigen::Index v = 0; v < normals.rows(); ++v) {
    EXPECT_GT(normals.row(v).dot(shape.vertices.row(v)), 0.99);
  }
}

TEST(ConnectedComponents, CountsPartsAndLooseVertices) {
  Shape shape = join(sphere(1), grid(3));
  shape.vertices.conservativeResize(shape.vertices.rows() + 1, 3);
  const Eigen::VectorXi labels = mesh::connected_components(shape.vertices.rows(), shape.faces);
  EXPECT_EQ(labels.maxCoeff(), 2);
  EXPECT_EQ(labels[0], 0);
  EXPECT_EQ(labels[18], 1);
  EXPECT_EQ(labels[labels.size() - 1], 2);
}

TEST(CotanLaplacian, AnnihilatesConstantsAndLinearFunctionsInThePlane) {
  Shape shape = grid(7, 3.0, 2.0);
  for (const auto mode : {Regularization::kRelative, Regularization::kAbsolute}) {
    const SparseMatrix laplacian = cotan_laplacian(shape.vertices, shape.faces, mode);
    EXPECT_LT((laplacian * Eigen::VectorXd::Ones(49)).cwiseAbs().maxCoeff(), 1e-12);
    const Eigen::VectorXd applied = laplacian * shape.vertices.col(0);
    EXPECT_NEAR(applied[3 * 7 + 3], 0.0, 1e-8);  // An interior vertex.
    // Dirichlet energy of x over an area of 6.
    EXPECT_NEAR(shape.vertices.col(0).dot(laplacian * shape.vertices.col(0)), 6.0, 1e-8);
  }
}

TEST(CotanLaplacian, StoresTheDiagonalOfVerticesWithoutFaces) {
  const Eigen::MatrixXd vertices = Eigen::MatrixXd::Random(5, 3);
  const SparseMatrix laplacian = cotan_laplacian(vertices, Eigen::RowVector3i(0, 2, 4));
  for (int v = 0; v < 5; ++v) {
    int stored = 0;
    for (SparseMatrix::InnerIterator entry(laplacian, v); entry; ++entry) {
      stored += entry.row() == v;
    }
    EXPECT_EQ(stored, 1) << v;  // else diagonal() += x writes where nothing is
  }
}

TEST(CotanLaplacian, StaysFiniteAndPositiveOnDegenerateFaces) {
  Shape shape = grid(5);
  const Eigen::Index old = shape.faces.rows();
  shape.faces.conservativeResize(old + 3, 3);
  shape.faces.row(old) << 0, 1, 2;      // collinear
  shape.faces.row(old + 1) << 3, 3, 4;  // a corner twice
  shape.faces.row(old + 2) << 7, 7, 7;  // a point
  const Eigen::MatrixXd laplacian = cotan_laplacian(shape.vertices, shape.faces);
  ASSERT_TRUE(laplacian.allFinite());
  std::mt19937 generator(0);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 20; ++i) {
    const Eigen::VectorXd x = Eigen::VectorXd::NullaryExpr(25, [&] { return normal(generator); });
    EXPECT_GE(x.dot(laplacian * x), -1e-9 * laplacian.cwiseAbs().maxCoeff());
  }
}

TEST(TangentFrames, AreRightHandedAndOrthonormal) {
  const Shape shape = sphere(2);
  const Eigen::MatrixXd normals = mesh::vertex_normals(shape.vertices, shape.faces);
  const Eigen::MatrixXd frames = tangent_frames(normals);
  for (Eigen::Index v = 0; v < frames.rows(); ++v) {
    const Eigen::Matrix3d frame = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(
        Eigen::RowVectorXd(frames.row(v)).data());
    EXPECT_TRUE((frame * frame.transpose()).isIdentity(1e-12));
    EXPECT_NEAR(frame.determinant(), 1.0, 1e-12);
    EXPECT_TRUE(frame.row(2).isApprox(normals.row(v)));
  }
}

TEST(VertexGradient, IsExactForLinearFunctionsInThePlaneAtAnyScale) {
  for (const double size : {1e-3, 1.0, 1e3}) {
    const Shape shape = grid(6, size, 2.0 * size);
    const Eigen::MatrixXd frames =
        tangent_frames(mesh::vertex_normals(shape.vertices, shape.faces));
    const RowSparseMatrix gradient = vertex_gradient(shape.vertices, shape.faces, frames);
    const Eigen::VectorXd linear = 3.0 * shape.vertices.col(0) - 2.0 * shape.vertices.col(1);
    const Eigen::VectorXd result = gradient * linear;
    // The ridge of 1e-5 of the mean eigenvalue biases by that, times the anisotropy of the edges.
    EXPECT_LT((result.head(36).array() - 3.0).abs().maxCoeff(), 3e-4);
    EXPECT_LT((result.tail(36).array() + 2.0).abs().maxCoeff(), 3e-4);
  }
}

TEST(VertexGradient, OfConstantsIsZeroAndOfLooseVerticesToo) {
  Shape shape = sphere(2);
  shape.vertices.conservativeResize(shape.vertices.rows() + 1, 3);
  shape.vertices.bottomRows(1).setZero();
  const Eigen::MatrixXd frames = tangent_frames(mesh::vertex_normals(shape.vertices, shape.faces));
  const RowSparseMatrix gradient = vertex_gradient(shape.vertices, shape.faces, frames);
  const Eigen::VectorXd ones = Eigen::VectorXd::Ones(shape.vertices.rows());
  EXPECT_LT((gradient * ones).cwiseAbs().maxCoeff(), 1e-10);
  EXPECT_EQ(gradient.row(shape.vertices.rows() - 1).nonZeros(), 0);
}

}  // namespace
}  // namespace freetalk::geometry
