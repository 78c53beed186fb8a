#include "freetalk/mesh/weld.h"

#include <gtest/gtest.h>

#include <ATen/ATen.h>

#include "../mesh/shapes.h"
#include "freetalk/geometry/operators.h"
#include "freetalk/geometry/surface.h"
#include "freetalk/mesh/components.h"

namespace freetalk::geometry {
namespace {

using testing::grid;
using testing::Shape;
using testing::sphere;

/// Every triangle with vertices of its own, as STL files have them.
Shape soup(const Shape& shape) {
  Shape result{Eigen::MatrixXd(3 * shape.faces.rows(), 3), Eigen::MatrixXi(shape.faces.rows(), 3)};
  for (Eigen::Index f = 0; f < shape.faces.rows(); ++f) {
    for (int c = 0; c < 3; ++c) {
      result.vertices.row(3 * f + c) = shape.vertices.row(shape.faces(f, c));
      result.faces(f, c) = static_cast<int>(3 * f + c);
    }
  }
  return result;
}

/// Every `step`-th triangle torn off: three vertices of its own, moved by `shift`.
Shape torn(const Shape& shape, int step, double shift) {
  std::vector<Eigen::Index> chosen;
  for (Eigen::Index f = 0; f < shape.faces.rows(); f += step) chosen.push_back(f);
  Shape result = shape;
  const auto extra = 3 * static_cast<Eigen::Index>(chosen.size());
  result.vertices.conservativeResize(shape.vertices.rows() + extra, 3);
  Eigen::Index next = shape.vertices.rows();
  for (const Eigen::Index f : chosen) {
    for (int c = 0; c < 3; ++c, ++next) {
      result.vertices.row(next) =
          shape.vertices.row(shape.faces(f, c)) + Eigen::RowVector3d(shift, -shift, shift);
      result.faces(f, c) = static_cast<int>(next);
    }
  }
  return result;
}

TEST(Weld, MakesASurfaceOfATriangleSoup) {
  const Shape shape = sphere(2);
  const mesh::WeldedSurface welded =
      mesh::weld(soup(shape).vertices, soup(shape).faces, "coincident");
  EXPECT_EQ(welded.vertices.rows(), shape.vertices.rows());
  EXPECT_EQ(welded.faces.rows(), shape.faces.rows());
  EXPECT_EQ(mesh::connected_components(welded.vertices.rows(), welded.faces).maxCoeff(), 0);
}

TEST(Weld, LaysTornFacesBackWhereTheyWere) {
  const Shape shape = sphere(3);
  const Shape broken = torn(shape, 17, 1e-3);
  const mesh::WeldedSurface welded = mesh::weld(broken.vertices, broken.faces, "fragments");
  EXPECT_EQ(welded.vertices, shape.vertices);
  EXPECT_EQ(welded.faces, shape.faces);
}

TEST(Weld, LaysLooseVerticesOntoTheNearest) {
  Shape shape = grid(12);
  shape.vertices.conservativeResize(145, 3);
  shape.vertices.row(144) << 1.3, 1.1, 0.2;
  const mesh::WeldedSurface welded = mesh::weld(shape.vertices, shape.faces, "fragments");
  EXPECT_EQ(welded.vertices.rows(), 144);
  EXPECT_EQ(welded.vertex_of[144], 143);
}

TEST(Weld, KeepsTheTwoSidesOfACoincidentSheetApart) {
  const Shape one = grid(6);
  Shape both{Eigen::MatrixXd(72, 3), Eigen::MatrixXi(2 * one.faces.rows(), 3)};
  both.vertices << one.vertices, one.vertices;
  both.faces.topRows(one.faces.rows()) = one.faces;
  both.faces.bottomRows(one.faces.rows()) = one.faces.rowwise().reverse().array() + 36;
  EXPECT_EQ(mesh::weld(both.vertices, both.faces, "fragments").vertices.rows(), 72);
}

TEST(Weld, LeavesWholeSurfacesAndCrumbsAloneAsTheyAre) {
  const Shape whole = sphere(2);
  EXPECT_EQ(mesh::weld(whole.vertices, whole.faces, "fragments").faces, whole.faces);
  const Shape crumb = grid(2);
  EXPECT_EQ(mesh::weld(crumb.vertices, crumb.faces, "fragments").vertices, crumb.vertices);
}

TEST(Weld, RefusesAnotherMode) {
  const Shape shape = grid(3);
  EXPECT_THROW(mesh::weld(shape.vertices, shape.faces, "glue"), std::invalid_argument);
}

TEST(SurfaceOperators, OfATornSurfaceKeepTheSpectrumOfTheWholeOne) {
  const Shape shape = sphere(3);
  const Shape broken = torn(shape, 9, 0.0);
  OperatorOptions options;
  options.k_eig = 20;
  const SurfaceOperators whole = surface_operators(shape.vertices, shape.faces, options);
  const SurfaceOperators mended = surface_operators(broken.vertices, broken.faces, options);
  EXPECT_TRUE(at::allclose(mended.evals, whole.evals, 1e-6, 1e-6));  // residuals of both solves
  EXPECT_NEAR(mended.mass.sum().item<double>(), whole.mass.sum().item<double>(), 1e-12);
  const at::Tensor products =
      mended.evecs.t().matmul(mended.mass.unsqueeze(1) * mended.evecs) - at::eye(20, at::kDouble);
  EXPECT_LT(products.abs().max().item<double>(), 1e-6);
  options.weld = "none";
  const SurfaceOperators apart = surface_operators(broken.vertices, broken.faces, options);
  // Nothing but the zeros of loose faces, up to the solver's residual; the sphere's own begin at 2.
  EXPECT_LT(apart.evals.max().item<double>(), 1e-4);
}

TEST(SurfaceOperators, OfATornSurfaceDifferentiateAcrossTheTear) {
  const Shape shape = grid(15);
  const Shape broken = torn(shape, 7, 0.0);
  OperatorOptions options;
  options.k_eig = 4;
  const SurfaceOperators operators = surface_operators(broken.vertices, broken.faces, options);
  const auto count = static_cast<int64_t>(broken.vertices.rows());
  at::Tensor height = at::empty({count, 1}, at::kDouble);
  for (int64_t v = 0; v < count; ++v) height[v][0] = 3.0 * broken.vertices(v, 0);
  const at::Tensor gradient = operators.gradients.to_sparse_csr().matmul(height).view({2, count});
  // The ridge of the least squares fit is 1e-5 of its matrix.
  EXPECT_TRUE(at::allclose(gradient[0], at::full({count}, 3.0, at::kDouble), 1e-4, 1e-4));
}

}  // namespace
}  // namespace freetalk::geometry
