#include <Eigen/Geometry>

#include <algorithm>

#include "freetalk/mesh/mesh.h"

namespace freetalk::mesh {
namespace {

using Corner2 = Eigen::Vector2d;

double cross(const Corner2& a, const Corner2& b, const Corner2& c) {
  return (b.x() - a.x()) * (c.y() - a.y()) - (b.y() - a.y()) * (c.x() - a.x());
}

/// Cosine between the normals of the two triangles a diagonal makes; -1 if one of them is
/// degenerate.
double fold(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& c,
            const Eigen::Vector3d& d) {
  const Eigen::Vector3d first = (b - a).cross(c - a);
  const Eigen::Vector3d second = (c - a).cross(d - a);
  const double norms = first.norm() * second.norm();
  return norms > 0.0 ? first.dot(second) / norms : -1.0;
}

void cut_quad(const Eigen::MatrixXd& vertices, const std::vector<int>& polygon,
              std::vector<Eigen::Vector3i>& out) {
  Eigen::Vector3d p[4];
  for (int i = 0; i < 4; ++i) p[i] = vertices.row(polygon[i]);
  const double along02 = fold(p[0], p[1], p[2], p[3]);
  const double along13 = fold(p[1], p[2], p[3], p[0]);
  constexpr double kSameFold = 1e-6;  // Nearly planar either way: the shorter diagonal.
  const bool shorter02 = (p[0] - p[2]).squaredNorm() <= (p[1] - p[3]).squaredNorm();
  const bool take02 = std::abs(along02 - along13) <= kSameFold ? shorter02 : along02 > along13;
  const int start = take02 ? 0 : 1;
  const auto at = [&](int i) { return polygon[(start + i) % 4]; };
  out.emplace_back(at(0), at(1), at(2));
  out.emplace_back(at(0), at(2), at(3));
}

/// The polygon in its mean plane (Newell's normal), counter-clockwise.
std::vector<Corner2> flatten(const Eigen::MatrixXd& vertices, const std::vector<int>& polygon) {
  const size_t n = polygon.size();
  const Eigen::Vector3d origin = vertices.row(polygon[0]);
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  for (size_t i = 0; i < n; ++i) {
    const Eigen::Vector3d a = vertices.row(polygon[i]).transpose() - origin;
    const Eigen::Vector3d b = vertices.row(polygon[(i + 1) % n]).transpose() - origin;
    normal += a.cross(b);
  }
  if (normal.norm() == 0.0) normal = Eigen::Vector3d::UnitZ();
  normal.normalize();
  const Eigen::Vector3d axis_x = normal.unitOrthogonal();
  const Eigen::Vector3d axis_y = normal.cross(axis_x);
  std::vector<Corner2> flat(n);
  for (size_t i = 0; i < n; ++i) {
    const Eigen::Vector3d p = vertices.row(polygon[i]).transpose() - origin;
    flat[i] = {p.dot(axis_x), p.dot(axis_y)};
  }
  return flat;
}

bool is_ear(const std::vector<Corner2>& flat, const std::vector<int>& ring, size_t i) {
  const size_t n = ring.size();
  const Corner2& a = flat[ring[(i + n - 1) % n]];
  const Corner2& b = flat[ring[i]];
  const Corner2& c = flat[ring[(i + 1) % n]];
  if (cross(a, b, c) <= 0.0) return false;
  for (size_t j = 0; j < n; ++j) {
    if (j == i || j == (i + 1) % n || j == (i + n - 1) % n) continue;
    const Corner2& p = flat[ring[j]];
    if (p == a || p == b || p == c) continue;  // Bridges to holes touch corners.
    if (cross(a, b, p) >= 0.0 && cross(b, c, p) >= 0.0 && cross(c, a, p) >= 0.0) return false;
  }
  return true;
}

void clip_ears(const Eigen::MatrixXd& vertices, const std::vector<int>& polygon,
               std::vector<Eigen::Vector3i>& out) {
  const std::vector<Corner2> flat = flatten(vertices, polygon);
  std::vector<int> ring(polygon.size());
  for (size_t i = 0; i < ring.size(); ++i) ring[i] = static_cast<int>(i);
  size_t start = 1;
  while (ring.size() > 3) {
    const size_t n = ring.size();
    size_t ear = start % n;
    for (size_t step = 0; step < n && !is_ear(flat, ring, ear); ++step) ear = (ear + 1) % n;
    // A self-crossing polygon may have no ear: any corner then, so that the loop ends with n - 2
    // triangles.
    out.emplace_back(polygon[ring[(ear + n - 1) % n]], polygon[ring[ear]],
                     polygon[ring[(ear + 1) % n]]);
    ring.erase(ring.begin() + static_cast<std::ptrdiff_t>(ear));
    start = ear + 1;  // Not the same neighbourhood again: fans of slivers are avoided.
  }
  out.emplace_back(polygon[ring[0]], polygon[ring[1]], polygon[ring[2]]);
}

}  // namespace

Triangulation triangulate(const Eigen::MatrixXd& vertices,
                          const std::vector<std::vector<int>>& polygons) {
  constexpr size_t kMaxEarClipping =
      2000;  // Ear clipping is cubic at worst: larger ones are fanned.
  std::vector<Eigen::Vector3i> triangles;
  triangles.reserve(polygons.size() * 2);
  Triangulation result;
  for (size_t index = 0; index < polygons.size(); ++index) {
    const std::vector<int>& polygon = polygons[index];
    if (polygon.size() == 3) {
      triangles.emplace_back(polygon[0], polygon[1], polygon[2]);
    } else if (polygon.size() == 4) {
      cut_quad(vertices, polygon, triangles);
    } else if (polygon.size() > kMaxEarClipping) {
      for (size_t i = 1; i + 1 < polygon.size(); ++i) {
        triangles.emplace_back(polygon[0], polygon[i], polygon[i + 1]);
      }
    } else if (polygon.size() > 4) {
      clip_ears(vertices, polygon, triangles);
    }
    result.face_polygon.resize(triangles.size(), static_cast<int>(index));
  }
  result.faces.resize(static_cast<Eigen::Index>(triangles.size()), 3);
  for (size_t i = 0; i < triangles.size(); ++i) {
    result.faces.row(static_cast<Eigen::Index>(i)) = triangles[i];
  }
  return result;
}

}  // namespace freetalk::mesh
