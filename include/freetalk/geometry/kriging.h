// Values known at a few points of a surface, spread smoothly over all of it.
//
// Kriging with the Matern covariance that a surface has of itself [Lindgren, Rue & Lindstrom 2011,
// "An explicit link between Gaussian fields and Gaussian Markov random fields", Section 2]: with
// the Laplacian L, the mass M and the range r
//   K = (L + M / r^2)^-1 M (L + M / r^2)^-1,   weights = K S^T (S K S^T + noise s I)^-1
// where S takes the values at the points and s is the mean variance there. It follows the surface,
// so nothing crosses a gap such as that between the lips, and fades away from the points.
#pragma once

#include <Eigen/Core>

namespace freetalk::geometry {

/// Points on triangles.
struct SurfacePoints {
  Eigen::MatrixXi corners;   ///< (N, 3) vertices of the triangle each lies on
  Eigen::MatrixXd shares;    ///< (N, 3) barycentric, rows sum to one
  Eigen::VectorXd distance;  ///< (N,) from the points that were looked for, m
};

/// The places of a surface nearest to points, on its side that faces their normals: first the
/// vertex, one turned at right angles counting as 6 mm further away, then the place among the
/// triangles around it. So closed lips and lids do not mix. A point within
/// 0.2 mm of the surface stays where it is.
/// @param vertices (V, 3) m. @param faces (F, 3). @param points (N, 3) m.
/// @param normals (N, 3) unit, outward; zero where unknown.
/// @throws std::invalid_argument for no faces, or points and normals that differ in number.
SurfacePoints nearest_on_surface(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                 const Eigen::MatrixXd& points, const Eigen::MatrixXd& normals);

struct KrigingOptions {
  double range = 0.01;   // r, unit of the vertices: how far a point reaches, > 0
  double noise = 0.005;  // of the values, share of their variance, > 0: calms points close together
  template <class V>
  void fields(V& v) {
    v("range", range);
    v("noise", noise);
  }
  /// @throws std::invalid_argument naming the option at fault.
  void check() const;
};

/// Weights of the points at every vertex. The surface is welded as for surface_operators; a
/// component without a point takes the weights of the nearest vertex of those that have one.
/// @param vertices (V, 3). @param faces (F, 3). @param points at least one.
/// @returns (V, N). @throws std::invalid_argument for options out of range or no points.
Eigen::MatrixXd kriging_weights(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                const SurfacePoints& points, const KrigingOptions& options = {});

}  // namespace freetalk::geometry
