#include "freetalk/geometry/kriging.h"

#include <Eigen/Cholesky>

#include <algorithm>
#include <cmath>
#include <limits>
#include <unordered_map>
#include <vector>

#include "freetalk/core/error.h"
#include "freetalk/geometry/sparse_cholesky.h"
#include "freetalk/geometry/surface.h"
#include "freetalk/mesh/components.h"
#include "freetalk/mesh/normals.h"
#include "freetalk/mesh/weld.h"
#include "geometry/triangle_tree.h"
#include "mesh/kd_tree.h"

namespace freetalk::geometry {
namespace {

using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// What a normal at right angles counts as, m: where the place is guessed, and where it is exact.
constexpr double kGuessed = 6e-3, kExact = 2e-4;
constexpr double kOnSurface = 2e-4;  // m: a point this near lies on the surface
constexpr double kAnySide = -2.0;    // cosine

/// (N,) the vertex of each point, by distance and normal.
Eigen::VectorXi nearest_vertices(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                 const Eigen::MatrixXd& points, const Eigen::MatrixXd& normals,
                                 double side_length) {
  std::vector<int> used(faces.data(), faces.data() + faces.size());
  std::sort(used.begin(), used.end());
  used.erase(std::unique(used.begin(), used.end()), used.end());
  const Eigen::MatrixXd of_vertices = mesh::vertex_normals(vertices, faces);
  const mesh::KdTree tree(vertices(used, Eigen::all).transpose(),
                          of_vertices(used, Eigen::all).transpose());
  Eigen::VectorXi result(points.rows());
  for (Eigen::Index n = 0; n < points.rows(); ++n) {
    const int found =
        tree.nearest(points.row(n).transpose(), normals.row(n).transpose(),
                     std::numeric_limits<double>::infinity(), kAnySide, side_length / std::sqrt(2));
    FREETALK_CHECK(found >= 0, "nearest places on a surface: point ", n, " is not finite");
    result[n] = used[static_cast<size_t>(found)];
  }
  return result;
}

/// The place nearest to each point among the triangles around its vertex.
SurfacePoints places_around(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                            const Eigen::MatrixXd& points, const Eigen::VectorXi& nearest) {
  std::unordered_map<int, std::vector<Eigen::Index>> asked;
  for (Eigen::Index n = 0; n < nearest.size(); ++n) asked[nearest[n]].push_back(n);
  SurfacePoints result;
  result.corners.resize(points.rows(), 3);
  result.shares.resize(points.rows(), 3);
  result.distance =
      Eigen::VectorXd::Constant(points.rows(), std::numeric_limits<double>::infinity());
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int i = 0; i < 3; ++i) {
      const auto around = asked.find(faces(f, i));
      if (around == asked.end()) continue;
      const Eigen::Vector3d a = vertices.row(faces(f, 0)), b = vertices.row(faces(f, 1)),
                            c = vertices.row(faces(f, 2));
      for (const Eigen::Index n : around->second) {
        const Eigen::Vector3d point = points.row(n);
        const Eigen::Vector3d shares = nearest_in_triangle(point, a, b, c);
        const double distance = (shares[0] * a + shares[1] * b + shares[2] * c - point).norm();
        if (distance >= result.distance[n]) continue;
        result.distance[n] = distance;
        result.corners.row(n) = faces.row(f);
        result.shares.row(n) = shares.transpose();
      }
    }
  }
  return result;
}

/// (W, N) of a welded surface.
Rows welded_weights(const mesh::WeldedSurface& surface, const SurfacePoints& points,
                    const KrigingOptions& options) {
  const Eigen::Index count = points.corners.rows(), size = surface.vertices.rows();
  const Eigen::VectorXd mass = lumped_mass(surface.vertices, surface.faces);
  SparseMatrix system = cotan_laplacian(surface.vertices, surface.faces);
  system.diagonal() += mass / (options.range * options.range);
  const SparseCholesky factor(system);
  Rows covariance = Rows::Zero(size, count);
  const auto corner = [&](Eigen::Index n, int i) {
    return surface.vertex_of[points.corners(n, i)];
  };
  for (Eigen::Index n = 0; n < count; ++n) {
    for (int i = 0; i < 3; ++i) covariance(corner(n, i), n) += points.shares(n, i);
  }
  factor.solve(covariance.data(), count);
  covariance = mass.asDiagonal() * covariance;
  factor.solve(covariance.data(), count);
  Eigen::MatrixXd between = Eigen::MatrixXd::Zero(count, count);
  for (Eigen::Index n = 0; n < count; ++n) {
    for (int i = 0; i < 3; ++i) {
      between.row(n) += points.shares(n, i) * covariance.row(corner(n, i));
    }
  }
  between = (0.5 * (between + between.transpose())).eval();
  between.diagonal().array() += options.noise * between.diagonal().mean();
  return between.ldlt().solve(covariance.transpose()).transpose();
}

/// Components without a point take what is nearest to them.
void fill_in(const mesh::WeldedSurface& surface, const SurfacePoints& points, Rows& weights) {
  const Eigen::VectorXi component =
      mesh::connected_components(surface.vertices.rows(), surface.faces);
  std::vector<bool> reached(static_cast<size_t>(component.maxCoeff()) + 1, false);
  for (const int vertex : points.corners.reshaped()) {
    reached[static_cast<size_t>(component[surface.vertex_of[vertex]])] = true;
  }
  std::vector<int> known, unknown;
  for (int v = 0; v < component.size(); ++v) {
    (reached[static_cast<size_t>(component[v])] ? known : unknown).push_back(v);
  }
  if (unknown.empty()) return;
  const mesh::KdTree tree(surface.vertices(known, Eigen::all).transpose());
  for (const int v : unknown) {
    const auto found = tree.nearest(surface.vertices.row(v).transpose(), 1);
    weights.row(v) = weights.row(known[static_cast<size_t>(found.front().index)]);
  }
}

}  // namespace

void KrigingOptions::check() const {
  FREETALK_CHECK(std::isfinite(range) && range > 0, "kriging: range must be positive, found ",
                 range);
  FREETALK_CHECK(std::isfinite(noise) && noise > 0, "kriging: noise must be positive, found ",
                 noise);
}

SurfacePoints nearest_on_surface(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                 const Eigen::MatrixXd& points, const Eigen::MatrixXd& normals) {
  FREETALK_CHECK(faces.rows() > 0, "nearest places on a surface: it has no faces");
  FREETALK_CHECK(points.rows() == normals.rows() && points.cols() == 3 && normals.cols() == 3,
                 "nearest places on a surface: expected points and normals (N, 3), found (",
                 points.rows(), ", ", points.cols(), ") and (", normals.rows(), ", ",
                 normals.cols(), ")");
  const auto places = [&](double side_length) {
    return places_around(vertices, faces, points,
                         nearest_vertices(vertices, faces, points, normals, side_length));
  };
  SurfacePoints result = places(kGuessed);
  const SurfacePoints exact = places(kExact);
  for (Eigen::Index n = 0; n < points.rows(); ++n) {
    if (exact.distance[n] > kOnSurface || result.distance[n] <= kOnSurface) continue;
    result.corners.row(n) = exact.corners.row(n);
    result.shares.row(n) = exact.shares.row(n);
    result.distance[n] = exact.distance[n];
  }
  return result;
}

Eigen::MatrixXd kriging_weights(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                const SurfacePoints& points, const KrigingOptions& options) {
  options.check();
  FREETALK_CHECK(points.corners.rows() > 0 && points.corners.rows() == points.shares.rows(),
                 "kriging: expected at least one point, found ", points.corners.rows());
  FREETALK_CHECK(points.corners.minCoeff() >= 0 && points.corners.maxCoeff() < vertices.rows(),
                 "kriging: the points lie on other vertices than 0 .. ", vertices.rows() - 1);
  const mesh::WeldedSurface surface = mesh::weld(vertices, faces, "fragments");
  Rows weights = welded_weights(surface, points, options);
  fill_in(surface, points, weights);
  return weights(surface.vertex_of, Eigen::all);
}

}  // namespace freetalk::geometry
