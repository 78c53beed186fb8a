// Local triangulations of point clouds, with the tolerances of `robust_laplacian`, so that both
// find the same triangles.
#include <Eigen/Geometry>
#include <Eigen/SVD>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>
#include <vector>

#include "core/parallel.h"
#include "freetalk/core/error.h"
#include "freetalk/geometry/robust_laplacian.h"
#include "mesh/kd_tree.h"

namespace freetalk::geometry {
namespace {

constexpr double kCoincident = 1e-7;  // of the neighbourhood's radius
constexpr double kCollinear = 1e-5;   // radians
constexpr double kCocircular = 1e-4;  // of the neighbourhood's radius

using Point2 = Eigen::Vector2d;

double cross(const Point2& a, const Point2& b) { return a.x() * b.y() - a.y() * b.x(); }

/// The direction of least spread of a point's neighbours about their mean.
Eigen::Vector3d plane_normal(const Eigen::MatrixXd& points, const Eigen::MatrixXi& neighbors,
                             Eigen::Index point, CloudFit fit) {
  const Eigen::Index count = neighbors.cols();
  Eigen::MatrixXd around(3, count);
  for (Eigen::Index i = 0; i < count; ++i) around.col(i) = points.row(neighbors(point, i));
  const auto divisor = static_cast<double>(fit == CloudFit::kPublished ? count + 1 : count);
  const Eigen::Vector3d center = around.rowwise().sum() / divisor;
  around.colwise() -= center;
  const Eigen::JacobiSVD<Eigen::MatrixXd> svd(around, Eigen::ComputeThinU);
  return svd.matrixU().col(2).normalized();
}

/// The neighbours in the plane, around the point as origin. Those on top of the point are moved
/// off it, each to another place.
std::vector<Point2> project(const Eigen::MatrixXd& points, const Eigen::MatrixXi& neighbors,
                            Eigen::Index point, const Eigen::Vector3d& normal) {
  const Eigen::Vector3d seed =
      std::abs(normal.x()) > 0.9 ? Eigen::Vector3d::UnitY() : Eigen::Vector3d::UnitX();
  const Eigen::Vector3d x = seed.cross(normal).normalized();
  const Eigen::Vector3d y = normal.cross(x);
  const auto count = static_cast<size_t>(neighbors.cols());
  std::vector<Point2> flat(count);
  for (size_t i = 0; i < count; ++i) {
    const Eigen::Vector3d offset =
        points.row(neighbors(point, static_cast<Eigen::Index>(i))) - points.row(point);
    flat[i] = {x.dot(offset), y.dot(offset)};
  }
  const double radius = flat.back().norm();
  for (size_t i = 0; i < count; ++i) {
    const double distance = flat[i].norm();
    if (distance >= kCoincident * radius) continue;
    const double part = static_cast<double>(i) / static_cast<double>(count);
    const double angle = 2.0 * std::numbers::pi * part;
    const Point2 direction =
        distance > 0.0 ? Point2(flat[i] / distance) : Point2(std::cos(angle), std::sin(angle));
    flat[i] = (1.0 + part) * 10.0 * kCoincident * radius * direction;
  }
  return flat;
}

/// Indices counter-clockwise, and whether the point lies on a boundary: a half-plane without
/// neighbours. The first is the one after that gap, or the nearest.
struct Fan {
  std::vector<size_t> order;
  bool open = false;
};

Fan sort_by_angle(const std::vector<Point2>& flat, CloudFit fit) {
  const size_t count = flat.size();
  std::vector<double> angles(count);
  for (size_t i = 0; i < count; ++i) angles[i] = std::atan2(flat[i].y(), flat[i].x());
  Fan fan;
  fan.order.resize(count);
  std::iota(fan.order.begin(), fan.order.end(), size_t{0});
  std::stable_sort(fan.order.begin(), fan.order.end(),
                   [&](size_t a, size_t b) { return angles[a] < angles[b]; });
  double widest = -1.0;
  size_t start = 0;
  for (size_t i = 0; i < count; ++i) {
    const bool last = i + 1 == count;
    if (last && fit == CloudFit::kPublished) break;
    const double gap = angles[fan.order[last ? 0 : i + 1]] - angles[fan.order[i]] +
                       (last ? 2.0 * std::numbers::pi : 0.0);
    if (gap > widest) {
      widest = gap;
      start = last ? 0 : i + 1;
    }
  }
  fan.open = widest > std::numbers::pi - kCollinear;
  if (!fan.open) {
    const auto nearer = [&](size_t a, size_t b) {
      return flat[a].squaredNorm() < flat[b].squaredNorm();
    };
    start = static_cast<size_t>(std::min_element(fan.order.begin(), fan.order.end(), nearer) -
                                fan.order.begin());
  }
  std::rotate(fan.order.begin(), fan.order.begin() + static_cast<std::ptrdiff_t>(start),
              fan.order.end());
  return fan;
}

/// Whether no other neighbour lies within the circle through the origin, a and b, but for a margin.
bool is_delaunay(const std::vector<Point2>& flat, size_t a, size_t b, double margin) {
  const double twice_area = 2.0 * cross(flat[a], flat[b]);
  const double aa = flat[a].squaredNorm(), bb = flat[b].squaredNorm();
  const Point2 center((flat[b].y() * aa - flat[a].y() * bb) / twice_area,
                      (flat[a].x() * bb - flat[b].x() * aa) / twice_area);
  const double radius = center.norm();
  for (size_t i = 0; i < flat.size(); ++i) {
    if (i == a || i == b) continue;
    if ((center - flat[i]).norm() + margin <= radius) return false;
  }
  return true;
}

/// Pairs of neighbours that make a Delaunay triangle with the origin, counter-clockwise.
std::vector<std::array<size_t, 2>> star(const std::vector<Point2>& flat, CloudFit fit) {
  std::vector<std::array<size_t, 2>> pairs;
  const double radius = flat.back().norm();
  if (!std::isfinite(radius) || radius <= 0.0) return pairs;
  const Fan fan = sort_by_angle(flat, fit);
  const size_t count = flat.size();
  const size_t end = count + (fan.open ? 0 : 1);
  for (size_t start = 0; start < count;) {
    const size_t a = fan.order[start];
    size_t next = start + 1;
    for (; next < end; ++next) {
      const size_t b = fan.order[next % count];
      if (std::abs(cross(flat[a].normalized(), flat[b].normalized())) < kCollinear) continue;
      if (is_delaunay(flat, a, b, kCocircular * radius)) break;
    }
    if (next < end) {
      pairs.push_back({a, fan.order[next % count]});
      start = next;
    } else {
      ++start;
    }
  }
  return pairs;
}

}  // namespace

PointCloudTriangles triangulate_point_cloud(const Eigen::MatrixXd& points, int64_t num_neighbors,
                                            CloudFit fit) {
  const Eigen::Index count = points.rows();
  FREETALK_CHECK(points.cols() == 3, "a point cloud needs points of shape (V, 3), found (", count,
                 ", ", points.cols(), ")");
  FREETALK_CHECK(points.allFinite(), "a point cloud needs finite points");
  FREETALK_CHECK(num_neighbors >= 3 && num_neighbors < count,
                 "num_neighbors must be between 3 and the number of points less one, found ",
                 num_neighbors, " for ", count, " points");
  PointCloudTriangles cloud;
  cloud.neighbors = mesh::nearest_points(points, static_cast<int>(num_neighbors));
  cloud.normals.resize(count, 3);
  std::vector<std::vector<std::array<size_t, 2>>> stars(static_cast<size_t>(count));
  core::parallel_for(0, count, 128, [&](int64_t begin, int64_t end) {
    for (int64_t v = begin; v < end; ++v) {
      const Eigen::Vector3d normal = plane_normal(points, cloud.neighbors, v, fit);
      cloud.normals.row(v) = normal;
      stars[static_cast<size_t>(v)] = star(project(points, cloud.neighbors, v, normal), fit);
    }
  });
  size_t total = 0;
  for (const auto& pairs : stars) total += pairs.size();
  cloud.triangles.resize(static_cast<Eigen::Index>(total), 3);
  Eigen::Index row = 0;
  for (Eigen::Index v = 0; v < count; ++v) {
    for (const auto& [a, b] : stars[static_cast<size_t>(v)]) {
      cloud.triangles.row(row++) << static_cast<int>(v),
          cloud.neighbors(v, static_cast<Eigen::Index>(a)),
          cloud.neighbors(v, static_cast<Eigen::Index>(b));
    }
  }
  return cloud;
}

}  // namespace freetalk::geometry
