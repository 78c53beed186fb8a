#include "intrinsic_triangulation.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>

namespace freetalk::geometry {
namespace {

/// Area from side lengths without cancellation (Kahan, "Miscalculating area and angles of a
/// needle-like triangle"); 0 where the triangle inequality fails.
double kahan_area(double a, double b, double c) {
  if (a < b) std::swap(a, b);
  if (b < c) std::swap(b, c);
  if (a < b) std::swap(a, b);
  const double product = (a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c));
  return 0.25 * std::sqrt(std::max(product, 0.0));
}

}  // namespace

IntrinsicTriangulation::IntrinsicTriangulation(std::vector<int> tails, std::vector<int> twins,
                                               std::vector<double> lengths)
    : tails_(std::move(tails)), twins_(std::move(twins)), lengths_(std::move(lengths)) {}

double IntrinsicTriangulation::area(int side) const {
  const int first = side - side % 3;
  return kahan_area(lengths_[first], lengths_[first + 1], lengths_[first + 2]);
}

/// Half the cotangent of the angle opposite to a side.
double IntrinsicTriangulation::half_cotangent(int side) const {
  const double a = lengths_[side], b = lengths_[next(side)], c = lengths_[next(next(side))];
  return (b * b + c * c - a * a) / (8.0 * area(side));
}

double IntrinsicTriangulation::weight(int side) const {
  return half_cotangent(side) + half_cotangent(twins_[side]);
}

/// The other diagonal of the two triangles at a side, laid out in the plane with the side on the
/// x-axis.
double IntrinsicTriangulation::flipped_length(int side) const {
  const double base = lengths_[side];
  const auto apex = [&](double from_start, double from_end, double area) {
    const double x = (base * base + from_start * from_start - from_end * from_end) / (2.0 * base);
    return Eigen::Vector2d(x, 2.0 * area / base);
  };
  const int twin = twins_[side];
  const Eigen::Vector2d above = apex(lengths_[next(next(side))], lengths_[next(side)], area(side));
  const Eigen::Vector2d below = apex(lengths_[next(twin)], lengths_[next(next(twin))], area(twin));
  return std::hypot(above.x() - below.x(), above.y() + below.y());
}

/// Replaces the edge a-b of triangles a b c and b a d by d-c; false if it cannot be done.
bool IntrinsicTriangulation::flip(int side) {
  const int twin = twins_[side];
  if (twin / 3 == side / 3) return false;  // A triangle folded onto itself: always Delaunay.
  const double length = flipped_length(side);
  if (!std::isfinite(length) || length <= 0.0) return false;
  // The outer sides b-c, c-a, a-d, d-b in `from` move so that the triangles become d c a and c d b.
  const std::array<int, 4> from{next(side), next(next(side)), next(twin), next(next(twin))};
  const std::array<int, 4> to{from[3], from[0], from[1], from[2]};
  struct Side {
    int tail;
    int twin;
    double length;
  };
  const auto moved = [&](int s) {
    const auto found = std::find(from.begin(), from.end(), s);
    return found == from.end() ? s : to[static_cast<size_t>(found - from.begin())];
  };
  std::array<Side, 4> sides;
  for (size_t i = 0; i < 4; ++i) {
    sides[i] = {tails_[from[i]], moved(twins_[from[i]]), lengths_[from[i]]};
  }
  const int c = sides[1].tail;
  const int d = sides[3].tail;
  for (size_t i = 0; i < 4; ++i) {
    tails_[to[i]] = sides[i].tail;
    twins_[to[i]] = sides[i].twin;
    lengths_[to[i]] = sides[i].length;
    twins_[sides[i].twin] = to[i];
  }
  tails_[side] = d;
  tails_[twin] = c;
  lengths_[side] = lengths_[twin] = length;
  return true;
}

int64_t IntrinsicTriangulation::flip_to_delaunay(double tolerance) {
  std::deque<int> queue;
  std::vector<char> waits(tails_.size(), 0);
  const auto push = [&](int side) {
    if (waits[side]) return;
    waits[side] = 1;
    queue.push_back(side);
  };
  for (int side = 0; side < static_cast<int>(tails_.size()); ++side) {
    if (side < twins_[side]) push(side);
  }
  int64_t flips = 0;
  while (!queue.empty()) {
    const int side = queue.front();
    queue.pop_front();
    waits[side] = 0;
    if (weight(side) >= -tolerance || !flip(side)) continue;
    ++flips;
    // All four outer edges are queued again, so those that waited in another slot are not lost.
    const int twin = twins_[side];
    for (const int outer : {next(side), next(next(side)), next(twin), next(next(twin))}) {
      push(outer);
    }
  }
  return flips;
}

SparseMatrix IntrinsicTriangulation::laplacian(Eigen::Index num_vertices) const {
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(tails_.size() * 2);
  for (int side = 0; side < static_cast<int>(tails_.size()); ++side) {
    const int i = tails_[side], j = tip(side);
    if (side > twins_[side] || i == j) continue;  // A loop has no difference along it.
    const double w = weight(side);
    entries.emplace_back(i, j, -w);
    entries.emplace_back(j, i, -w);
    entries.emplace_back(i, i, w);
    entries.emplace_back(j, j, w);
  }
  SparseMatrix matrix(num_vertices, num_vertices);
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

Eigen::VectorXd IntrinsicTriangulation::lumped_mass(Eigen::Index num_vertices) const {
  Eigen::VectorXd mass = Eigen::VectorXd::Zero(num_vertices);
  for (int side = 0; side < static_cast<int>(tails_.size()); ++side) {
    mass[tails_[side]] += area(side) / 3.0;
  }
  return mass;
}

}  // namespace freetalk::geometry
