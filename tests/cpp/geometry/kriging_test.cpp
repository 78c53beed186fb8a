#include "freetalk/geometry/kriging.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "geometry/triangle_tree.h"
#include "square.h"

namespace freetalk::geometry {
namespace {

SurfacePoints at_vertices(const std::vector<int>& vertices) {
  SurfacePoints points;
  const auto count = static_cast<Eigen::Index>(vertices.size());
  points.corners.resize(count, 3);
  points.shares = Eigen::MatrixXd::Zero(count, 3);
  points.distance = Eigen::VectorXd::Zero(count);
  for (Eigen::Index n = 0; n < count; ++n) {
    points.corners.row(n).setConstant(vertices[static_cast<size_t>(n)]);
    points.shares(n, 0) = 1.0;
  }
  return points;
}

constexpr int kBelow = 21 * 9 + 10, kAbove = 21 * 12 + 10;  // 15 mm apart across the slit

TEST(NearestInTriangle, IsOnTheLongestEdgeWhereThereIsNoArea) {
  std::srand(3);
  for (int trial = 0; trial < 5000; ++trial) {
    const Eigen::Vector3d from = Eigen::Vector3d::Random(), along = Eigen::Vector3d::Random();
    const Eigen::Vector3d point = from + 2.0 * Eigen::Vector3d::Random();
    const double t = (point - from).dot(along) / along.squaredNorm();
    const double expected = (from + std::clamp(t, 0.0, 1.0) * along - point).norm();
    std::array<double, 3> places{0.0, std::rand() / double(RAND_MAX), 1.0};
    std::rotate(places.begin(), places.begin() + trial % 3, places.end());
    Eigen::Matrix3d corners;
    for (int i = 0; i < 3; ++i) corners.col(i) = from + places[static_cast<size_t>(i)] * along;
    const Eigen::Vector3d shares =
        nearest_in_triangle(point, corners.col(0), corners.col(1), corners.col(2));
    EXPECT_NEAR(shares.sum(), 1.0, 1e-12);
    EXPECT_GE(shares.minCoeff(), 0.0);
    EXPECT_NEAR((corners * shares - point).norm(), expected, 1e-12);  // of numbers around 1
  }
}

TEST(Kriging, KeepsTheValuesAtThePoints) {
  const Square square(false);
  const std::vector<int> chosen = {21 * 5 + 5, 21 * 6 + 15, 21 * 15 + 10};
  const Eigen::MatrixXd weights =
      kriging_weights(square.vertices, square.faces, at_vertices(chosen), {0.02, 1e-8});
  const Eigen::MatrixXd there = weights(chosen, Eigen::all);
  EXPECT_LT((there - Eigen::MatrixXd::Identity(3, 3)).cwiseAbs().maxCoeff(), 1e-6);
}

TEST(Kriging, NothingCrossesASlit) {
  const SurfacePoints points = at_vertices({kBelow});
  const Square whole(false), cut(true);
  const KrigingOptions options{0.02, 0.005};
  const double through = kriging_weights(whole.vertices, whole.faces, points, options)(kAbove, 0);
  const double around = kriging_weights(cut.vertices, cut.faces, points, options)(kAbove, 0);
  EXPECT_GT(through, 0.5);
  EXPECT_LT(around, 0.25 * through);
}

TEST(Kriging, FadesWithTheRange) {
  const Square square(false);
  const SurfacePoints corner = at_vertices({0});
  const auto far = [&](double range) {
    return kriging_weights(square.vertices, square.faces, corner, {range, 0.005})(440, 0);
  };
  EXPECT_LT(far(0.005), 1e-3);
  EXPECT_GT(far(0.2), 0.5);
}

TEST(Kriging, LooseFragmentsFollowWhatTheyLieOn) {
  Square square(false);
  Eigen::MatrixXd vertices(444, 3);
  vertices << square.vertices,
      Eigen::MatrixXd(square.vertices(std::vector{199, 200, 220}, Eigen::all));
  vertices.bottomRows(3).col(2).array() += 1e-3;
  Eigen::MatrixXi faces(square.faces.rows() + 1, 3);
  faces << square.faces, Eigen::RowVector3i(441, 442, 443);
  const Eigen::MatrixXd weights = kriging_weights(vertices, faces, at_vertices({kBelow, 0}));
  EXPECT_LT((weights.row(441) - weights.row(199)).cwiseAbs().maxCoeff(), 0.05);
}

TEST(Kriging, OptionsOutOfRangeAreRefused) {
  const Square square(false);
  EXPECT_THROW(kriging_weights(square.vertices, square.faces, at_vertices({0}), {0.0, 0.1}),
               std::invalid_argument);
  EXPECT_THROW(kriging_weights(square.vertices, square.faces, at_vertices({0}), {0.1, 0.0}),
               std::invalid_argument);
  EXPECT_THROW(kriging_weights(square.vertices, square.faces, at_vertices({})),
               std::invalid_argument);
}

TEST(NearestOnSurface, FindsThePlaceInATriangleAndItsDistance) {
  const Square square(false);
  Eigen::MatrixXd point(1, 3), up(1, 3);
  point << 0.0123, 0.0456, 0.003;
  up << 0, 0, 1;
  const SurfacePoints found = nearest_on_surface(square.vertices, square.faces, point, up);
  Eigen::Vector3d place = Eigen::Vector3d::Zero();
  for (int i = 0; i < 3; ++i) {
    place += found.shares(0, i) * square.vertices.row(found.corners(0, i)).transpose();
  }
  EXPECT_LT((place - Eigen::Vector3d(0.0123, 0.0456, 0.0)).norm(), 1e-12);
  EXPECT_NEAR(found.distance[0], 0.003, 1e-12);
}

TEST(NearestOnSurface, TakesTheSideThatFacesTheNormal) {
  const Square square(false);
  Eigen::MatrixXd vertices(882, 3);  // a second sheet 1 mm below, turned over
  vertices << square.vertices, square.vertices;
  vertices.bottomRows(441).col(2).array() -= 1e-3;
  Eigen::MatrixXi faces(2 * square.faces.rows(), 3);
  faces << square.faces, square.faces.rowwise().reverse().array() + 441;
  Eigen::MatrixXd point(1, 3), normal(1, 3);
  point << 0.05, 0.05, -0.0005;  // between the two
  normal << 0, 0, -1;
  EXPECT_GE(nearest_on_surface(vertices, faces, point, normal).corners.minCoeff(), 441);
  EXPECT_LT(nearest_on_surface(vertices, faces, point, -normal).corners.maxCoeff(), 441);
}

}  // namespace
}  // namespace freetalk::geometry
