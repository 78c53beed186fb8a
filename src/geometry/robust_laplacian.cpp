#include "freetalk/geometry/robust_laplacian.h"

#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <tuple>
#include <utility>

#include "freetalk/core/error.h"
#include "intrinsic_triangulation.h"

namespace freetalk::geometry {
namespace {

/// Edges whose cotangent weight is above minus this count as Delaunay, so that cocircular ones are
/// not flipped back and forth; the value of `robust_laplacian`.
constexpr double kDelaunayTolerance = 1e-6;

/// Sides of the triangles grouped by the two vertices they join, in order of first appearance.
struct Edges {
  std::vector<int> offsets;  ///< Of each edge into `sides`, and the end.
  std::vector<int> sides;    ///< 3 f + c from corner c to corner c + 1 of face f, ascending.
  std::vector<int> of_side;  ///< (3 F) edge of each side.

  int count() const { return static_cast<int>(offsets.size()) - 1; }
};

Edges group_sides(const Eigen::MatrixXi& faces) {
  const int count = static_cast<int>(faces.rows()) * 3;
  struct Key {
    int low, high, side;
  };
  std::vector<Key> keys(static_cast<size_t>(count));
  for (int side = 0; side < count; ++side) {
    const auto [low, high] =
        std::minmax({faces(side / 3, side % 3), faces(side / 3, (side + 1) % 3)});
    keys[side] = {low, high, side};
  }
  std::sort(keys.begin(), keys.end(), [](const Key& a, const Key& b) {
    return std::tie(a.low, a.high, a.side) < std::tie(b.low, b.high, b.side);
  });
  Edges edges;
  edges.of_side.resize(keys.size());
  for (size_t i = 0; i < keys.size(); ++i) {
    const bool same = i > 0 && keys[i].low == keys[i - 1].low && keys[i].high == keys[i - 1].high;
    if (!same) edges.offsets.push_back(static_cast<int>(i));
    edges.sides.push_back(keys[i].side);
    edges.of_side[keys[i].side] = static_cast<int>(edges.offsets.size()) - 1;
  }
  edges.offsets.push_back(count);
  return edges;
}

/// Lengths of the edges, all longer by the least amount with which every triangle inequality holds
/// by `factor` mean lengths (Eq. 7 of the paper).
std::vector<double> mollified_lengths(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                      const Edges& edges, double factor) {
  std::vector<double> lengths(static_cast<size_t>(edges.count()));
  for (int e = 0; e < edges.count(); ++e) {
    const int side = edges.sides[edges.offsets[e]];
    lengths[e] =
        (vertices.row(faces(side / 3, side % 3)) - vertices.row(faces(side / 3, (side + 1) % 3)))
            .norm();
  }
  const double mean = std::accumulate(lengths.begin(), lengths.end(), 0.0) / edges.count();
  FREETALK_CHECK(mean > 0.0, "the robust Laplacian needs triangles with extent; all edges of the ",
                 faces.rows(), " faces have length zero");
  if (factor <= 0.0) return lengths;
  double missing = 0.0;
  for (int side = 0; side < static_cast<int>(edges.of_side.size()); ++side) {
    const int first = side - side % 3;
    const double a = lengths[edges.of_side[side]];
    const double b = lengths[edges.of_side[first + (side + 1) % 3]];
    const double c = lengths[edges.of_side[first + (side + 2) % 3]];
    missing = std::max(missing, c - a - b + factor * mean);
  }
  for (double& length : lengths) length += missing;
  return lengths;
}

/// The side of the back of a face along a side of its front; fronts are faces 0 .. F - 1 as given,
/// backs F .. 2 F - 1 with corners 0, 2, 1. And the reverse.
int other_sheet(int side, int num_faces) {
  const int face = side / 3;
  const int other = face < num_faces ? face + num_faces : face - num_faces;
  return 3 * other + 2 - side % 3;
}

/// Sides of one edge in clockwise order around it, seen against the direction of the first.
/// Sides at equal angles (of repeated faces) keep the order in which `robust_laplacian` meets them:
/// the first, then from the last down.
void sort_around_edge(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                      std::vector<int>& sides) {
  std::reverse(sides.begin() + 1, sides.end());
  const int first = sides.front();
  const Eigen::Vector3d tail = vertices.row(faces(first / 3, first % 3));
  const Eigen::Vector3d tip = vertices.row(faces(first / 3, (first + 1) % 3));
  const Eigen::Vector3d axis = (tip - tail).stableNormalized();
  const Eigen::Vector3d seed =
      std::abs(axis.x()) > 0.9 ? Eigen::Vector3d::UnitY() : Eigen::Vector3d::UnitX();
  const Eigen::Vector3d x = seed.cross(axis).stableNormalized();
  const Eigen::Vector3d y = axis.cross(x);
  std::vector<std::pair<double, int>> angles;
  angles.reserve(sides.size());
  for (const int side : sides) {
    const Eigen::Vector3d apex = vertices.row(faces(side / 3, (side + 2) % 3));
    const Eigen::Vector3d out = (apex - tail).stableNormalized();
    angles.emplace_back(std::atan2(y.dot(out), x.dot(out)), side);
  }
  std::stable_sort(angles.begin(), angles.end(),
                   [](const auto& a, const auto& b) { return a.first > b.first; });
  for (size_t i = 0; i < sides.size(); ++i) sides[i] = angles[i].second;
}

/// The tufted cover (Section 4.2): two sheets a face, glued around each edge so that the sheets
/// which look at each other meet; a face alone at an edge meets its own back.
IntrinsicTriangulation tufted_cover(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                    const Edges& edges, const std::vector<double>& edge_lengths) {
  const int num_faces = static_cast<int>(faces.rows());
  std::vector<int> tails(static_cast<size_t>(num_faces) * 6), twins(tails.size());
  std::vector<double> lengths(tails.size());
  for (int side = 0; side < 3 * num_faces; ++side) {
    const int back = other_sheet(side, num_faces);
    tails[side] = faces(side / 3, side % 3);
    tails[back] = faces(side / 3, (side + 1) % 3);
    lengths[side] = lengths[back] = edge_lengths[edges.of_side[side]];
  }
  std::vector<int> around;
  for (int e = 0; e < edges.count(); ++e) {
    around.assign(edges.sides.begin() + edges.offsets[e],
                  edges.sides.begin() + edges.offsets[e + 1]);
    const int tail = tails[around.front()];
    if (around.size() > 2) sort_around_edge(vertices, faces, around);
    for (size_t i = 0; i < around.size(); ++i) {
      int side = around[i], after = around[(i + 1) % around.size()];
      // The sheet that looks clockwise runs against the edge, the one it looks at along it.
      if (tails[side] == tail) side = other_sheet(side, num_faces);
      if (tails[after] != tail) after = other_sheet(after, num_faces);
      twins[side] = after;
      twins[after] = side;
    }
  }
  return {std::move(tails), std::move(twins), std::move(lengths)};
}

/// The power of two that brings the largest coordinate to 1 .. 2: lengths neither overflow nor
/// vanish when squared, and no bit changes.
int unit_exponent(const Eigen::MatrixXd& vertices) {
  const double largest = vertices.cwiseAbs().maxCoeff();
  return largest > 0.0 ? std::ilogb(largest) : 0;
}

}  // namespace

LaplacianAndMass robust_laplacian(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                  double mollify_factor) {
  FREETALK_CHECK(vertices.cols() == 3 && faces.cols() == 3,
                 "the robust Laplacian needs vertices (V, 3) and faces (F, 3), found (",
                 vertices.rows(), ", ", vertices.cols(), ") and (", faces.rows(), ", ",
                 faces.cols(), ")");
  FREETALK_CHECK(vertices.allFinite(), "the robust Laplacian needs finite vertices");
  FREETALK_CHECK(mollify_factor >= 0.0 && std::isfinite(mollify_factor),
                 "mollify_factor must be at least 0, found ", mollify_factor);
  FREETALK_CHECK(faces.rows() > 0, "the robust Laplacian needs at least one face");
  FREETALK_CHECK(faces.minCoeff() >= 0 && faces.maxCoeff() < vertices.rows(),
                 "the robust Laplacian needs face indices within 0 .. ", vertices.rows() - 1);
  const int exponent = unit_exponent(vertices);
  const Eigen::MatrixXd points =
      vertices.unaryExpr([exponent](double x) { return std::ldexp(x, -exponent); });
  const Edges edges = group_sides(faces);
  IntrinsicTriangulation cover =
      tufted_cover(points, faces, edges, mollified_lengths(points, faces, edges, mollify_factor));
  cover.flip_to_delaunay(kDelaunayTolerance);
  // Both sheets count: half of each.
  LaplacianAndMass result{0.5 * cover.laplacian(vertices.rows()),
                          0.5 * cover.lumped_mass(vertices.rows())};
  Eigen::VectorXi used = Eigen::VectorXi::Zero(vertices.rows());
  for (const int v : faces.reshaped()) used[v] = 1;
  double smallest = std::numeric_limits<double>::infinity();
  for (Eigen::Index v = 0; v < used.size(); ++v) {
    if (used[v]) smallest = std::min(smallest, result.mass[v]);
  }
  for (Eigen::Index v = 0; v < used.size(); ++v) {
    if (used[v]) continue;
    result.laplacian.coeffRef(v, v) = 1.0;
    result.mass[v] = 1e-3 * smallest;
  }
  result.laplacian.makeCompressed();
  result.mass = result.mass.unaryExpr([exponent](double m) { return std::ldexp(m, 2 * exponent); });
  return result;
}

LaplacianAndMass point_cloud_laplacian(const Eigen::MatrixXd& points,
                                       const PointCloudTriangles& cloud, double mollify_factor) {
  LaplacianAndMass result = robust_laplacian(points, cloud.triangles, mollify_factor);
  // A triangle of a well sampled surface appears at each of its three points.
  Eigen::VectorXd share = Eigen::VectorXd::Ones(points.rows());
  for (const int v : cloud.triangles.reshaped()) share[v] = 1.0 / 3.0;
  result.laplacian = share.asDiagonal() * result.laplacian;
  result.mass /= 3.0;
  return result;
}

LaplacianAndMass point_cloud_laplacian(const Eigen::MatrixXd& points, double mollify_factor,
                                       int64_t num_neighbors, CloudFit fit) {
  return point_cloud_laplacian(points, triangulate_point_cloud(points, num_neighbors, fit),
                               mollify_factor);
}

}  // namespace freetalk::geometry
