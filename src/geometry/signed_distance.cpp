#include "freetalk/geometry/signed_distance.h"

#include <cmath>

#include "core/parallel.h"
#include "freetalk/core/error.h"
#include "geometry/triangle_tree.h"

namespace freetalk::geometry {

struct SurfaceTree::Tree : TriangleTree {
  using TriangleTree::TriangleTree;
};

namespace {

constexpr int64_t kPointsAtOnce = 256;  // points a thread takes at once

void check_surface(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces) {
  FREETALK_CHECK(vertices.cols() == 3 && faces.cols() == 3 && faces.rows() > 0,
                 "a surface needs vertices (V, 3) and faces (F, 3), found (", vertices.rows(), ", ",
                 vertices.cols(), ") and (", faces.rows(), ", ", faces.cols(), ")");
  FREETALK_CHECK(vertices.allFinite(), "vertices of the surface must be finite");
  FREETALK_CHECK(faces.minCoeff() >= 0 && faces.maxCoeff() < vertices.rows(),
                 "faces must name rows of the ", vertices.rows(), " vertices");
}

template <class Body>
void each_point(const Eigen::MatrixXd& points, const Body& body) {
  FREETALK_CHECK(points.cols() == 3, "points must have the shape (N, 3), found (", points.rows(),
                 ", ", points.cols(), ")");
  FREETALK_CHECK(points.allFinite(), "points must be finite");
  core::parallel_for(0, points.rows(), kPointsAtOnce, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) body(i, Eigen::Vector3d(points.row(i)));
  });
}

}  // namespace

SurfaceTree::SurfaceTree(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces)
    : tree_((check_surface(vertices, faces), std::make_unique<Tree>(vertices, faces))) {}
SurfaceTree::~SurfaceTree() = default;
SurfaceTree::SurfaceTree(SurfaceTree&&) noexcept = default;
SurfaceTree& SurfaceTree::operator=(SurfaceTree&&) noexcept = default;

NearestOnSurface SurfaceTree::nearest(const Eigen::MatrixXd& points) const {
  NearestOnSurface result{Eigen::MatrixXd(points.rows(), 3), Eigen::VectorXd(points.rows()),
                          Eigen::VectorXi(points.rows())};
  each_point(points, [&](int64_t i, const Eigen::Vector3d& point) {
    const TriangleTree::Nearest found = tree_->nearest(point);
    result.points.row(i) = found.point;
    result.distances[i] = std::sqrt(found.squared);
    result.faces[i] = found.face;
  });
  return result;
}

Eigen::VectorXd SurfaceTree::winding_number(const Eigen::MatrixXd& points, double accuracy) const {
  FREETALK_CHECK(accuracy >= 1.0, "accuracy must be at least 1, found ", accuracy);
  Eigen::VectorXd result(points.rows());
  each_point(points, [&](int64_t i, const Eigen::Vector3d& point) {
    result[i] = tree_->winding_number(point, accuracy);
  });
  return result;
}

Eigen::VectorXd SurfaceTree::signed_distance(const Eigen::MatrixXd& points) const {
  constexpr double kAccuracy = 2.0;
  Eigen::VectorXd result(points.rows());
  each_point(points, [&](int64_t i, const Eigen::Vector3d& point) {
    const double distance = std::sqrt(tree_->nearest(point).squared);
    result[i] = tree_->winding_number(point, kAccuracy) >= 0.5 ? -distance : distance;
  });
  return result;
}

Eigen::VectorXd signed_distance(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                const Eigen::MatrixXd& points) {
  return SurfaceTree(vertices, faces).signed_distance(points);
}

}  // namespace freetalk::geometry
