#include "geometry/triangle_tree.h"

#include <Eigen/Geometry>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

namespace freetalk::geometry {
namespace {

constexpr int kDepth = 64;            // halves of at most 2^31 triangles fit
constexpr double kLeastArea = 1e-12;  // squared, relative to the sides': what rounding leaves

double squared_to_box(const Eigen::Vector3d& p, const Eigen::Vector3d& low,
                      const Eigen::Vector3d& high) {
  return (low - p).cwiseMax(p - high).cwiseMax(0.0).squaredNorm();
}

/// Half the solid angle of a triangle (van Oosterom & Strackee 1983), corners relative to the
/// point.
double half_solid_angle(const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                        const Eigen::Vector3d& c) {
  const double la = a.norm(), lb = b.norm(), lc = c.norm();
  return std::atan2(a.dot(b.cross(c)),
                    la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb);
}

}  // namespace

Eigen::Vector3d nearest_in_triangle(const Eigen::Vector3d& p, const Eigen::Vector3d& a,
                                    const Eigen::Vector3d& b, const Eigen::Vector3d& c) {
  const auto share = [](double part, double rest) {
    return part + rest > 0.0 ? part / (part + rest) : 0.0;
  };
  const Eigen::Vector3d ab = b - a, ac = c - a, ap = p - a;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0.0 && d2 <= 0.0) return {1.0, 0.0, 0.0};
  const Eigen::Vector3d bp = p - b;
  const double d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0.0 && d4 <= d3) return {0.0, 1.0, 0.0};
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 && d1 > d3) {
    const double t = share(d1, -d3);
    return {1.0 - t, t, 0.0};
  }
  const Eigen::Vector3d cp = p - c;
  const double d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0.0 && d5 <= d6) return {0.0, 0.0, 1.0};
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 && d2 > d6) {
    const double t = share(d2, -d6);
    return {1.0 - t, 0.0, t};
  }
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0.0 && d4 >= d3 && d5 >= d6) {
    const double t = share(d4 - d3, d5 - d6);
    return {0.0, 1.0 - t, t};
  }
  const double area = va + vb + vc, ab2 = ab.squaredNorm(), ac2 = ac.squaredNorm();
  if (area > kLeastArea * ab2 * ac2) return {va / area, vb / area, vc / area};
  // Rounding decided: the longest edge is all there is of the triangle.
  const double bc2 = (c - b).squaredNorm();
  const auto along = [](double part, double whole) { return std::clamp(part / whole, 0.0, 1.0); };
  if (ab2 >= std::max(ac2, bc2)) {
    const double t = along(d1, ab2);
    return {1.0 - t, t, 0.0};
  }
  if (ac2 >= bc2) {
    const double t = along(d2, ac2);
    return {1.0 - t, 0.0, t};
  }
  const double t = along(d4 - d3, bc2);
  return {0.0, 1.0 - t, t};
}

TriangleTree::TriangleTree(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces) {
  triangles_.reserve(static_cast<size_t>(faces.rows()));
  for (int f = 0; f < static_cast<int>(faces.rows()); ++f) {
    triangles_.push_back(
        {vertices.row(faces(f, 0)), vertices.row(faces(f, 1)), vertices.row(faces(f, 2)), f});
  }
  nodes_.reserve(triangles_.size());
  build(0, static_cast<int>(triangles_.size()));
}

int TriangleTree::build(int begin, int end) {
  const int index = static_cast<int>(nodes_.size());
  nodes_.emplace_back();
  Node node;
  node.begin = begin;
  node.end = end;
  node.right = 0;
  node.low.setConstant(std::numeric_limits<double>::infinity());
  node.high = -node.low;
  Eigen::Vector3d low = node.low, high = node.high;  // of three times the centroids
  const auto middle_of = [](const Triangle& t) -> Eigen::Vector3d { return t.a + t.b + t.c; };
  for (int i = begin; i < end; ++i) {
    const Triangle& t = triangles_[i];
    node.low = node.low.cwiseMin(t.a).cwiseMin(t.b).cwiseMin(t.c);
    node.high = node.high.cwiseMax(t.a).cwiseMax(t.b).cwiseMax(t.c);
    low = low.cwiseMin(middle_of(t));
    high = high.cwiseMax(middle_of(t));
  }
  set_moments(node);
  if (end - begin > kLeaf) {
    int axis = 0;
    (high - low).maxCoeff(&axis);
    const int middle = (begin + end) / 2;
    std::nth_element(triangles_.begin() + begin, triangles_.begin() + middle,
                     triangles_.begin() + end, [&](const Triangle& s, const Triangle& t) {
                       return s.a[axis] + s.b[axis] + s.c[axis] < t.a[axis] + t.b[axis] + t.c[axis];
                     });
    build(begin, middle);
    node.right = build(middle, end);
  }
  nodes_[index] = node;
  return index;
}

void TriangleTree::set_moments(Node& node) const {
  double total = 0.0;
  node.center.setZero();
  node.area.setZero();
  for (int i = node.begin; i < node.end; ++i) {
    const Triangle& t = triangles_[i];
    const Eigen::Vector3d area = 0.5 * (t.b - t.a).cross(t.c - t.a);
    const double size = area.norm();
    node.area += area;
    node.center += size / 3.0 * (t.a + t.b + t.c);
    total += size;
  }
  node.center = total > 0.0 ? Eigen::Vector3d(node.center / total) : triangles_[node.begin].a;
  node.moment.setZero();
  double squared = 0.0;
  for (int i = node.begin; i < node.end; ++i) {
    const Triangle& t = triangles_[i];
    const Eigen::Vector3d area = 0.5 * (t.b - t.a).cross(t.c - t.a);
    node.moment += ((t.a + t.b + t.c) / 3.0 - node.center) * area.transpose();
    for (const Eigen::Vector3d* p : {&t.a, &t.b, &t.c}) {
      squared = std::max(squared, (*p - node.center).squaredNorm());
    }
  }
  node.radius = std::sqrt(squared);
}

TriangleTree::Nearest TriangleTree::nearest(const Eigen::Vector3d& point) const {
  Nearest best;
  best.squared = std::numeric_limits<double>::infinity();
  std::array<std::pair<int, double>, kDepth> stack;
  size_t depth = 0;
  stack[depth++] = {0, squared_to_box(point, nodes_[0].low, nodes_[0].high)};
  while (depth > 0) {
    const auto [index, squared] = stack[--depth];
    if (squared > best.squared) continue;
    const Node& node = nodes_[index];
    if (node.right == 0) {
      for (int i = node.begin; i < node.end; ++i) {
        const Triangle& t = triangles_[i];
        const Eigen::Vector3d shares = nearest_in_triangle(point, t.a, t.b, t.c);
        const Eigen::Vector3d at = shares[0] * t.a + shares[1] * t.b + shares[2] * t.c;
        const double distance = (at - point).squaredNorm();
        if (distance < best.squared || (distance == best.squared && t.face < best.face)) {
          best = {at, distance, t.face};
        }
      }
      continue;
    }
    std::pair<int, double> near{index + 1, 0.0}, far{node.right, 0.0};
    for (auto* child : {&near, &far}) {
      child->second = squared_to_box(point, nodes_[child->first].low, nodes_[child->first].high);
    }
    if (far.second < near.second) std::swap(near, far);
    stack[depth++] = far;
    stack[depth++] = near;
  }
  return best;
}

double TriangleTree::winding_number(const Eigen::Vector3d& point, double accuracy) const {
  double angle = 0.0;  // solid, halved
  std::array<int, kDepth> stack;
  size_t depth = 0;
  stack[depth++] = 0;
  while (depth > 0) {
    const int index = stack[--depth];
    const Node& node = nodes_[index];
    const Eigen::Vector3d away = node.center - point;
    const double squared = away.squaredNorm();
    if (squared > accuracy * accuracy * node.radius * node.radius) {
      const double turned = away.dot(node.moment * away);
      angle += 0.5 * (node.area.dot(away) + node.moment.trace() - 3.0 * turned / squared) /
               (squared * std::sqrt(squared));
    } else if (node.right == 0) {
      for (int i = node.begin; i < node.end; ++i) {
        const Triangle& t = triangles_[i];
        angle += half_solid_angle(t.a - point, t.b - point, t.c - point);
      }
    } else {
      stack[depth++] = node.right;
      stack[depth++] = index + 1;
    }
  }
  return angle / (2.0 * std::numbers::pi);
}

}  // namespace freetalk::geometry
