// Skin that slides over eyeballs instead of through them.
//
// Around its centre an eyeball is a radius rho(u) in each direction u, cornea and all, tabulated
// over the half that looks out of the face. A vertex of the skin that lies d above it at rest stays
// at least min(d, 0.8 mm) above it: it is moved straight out where its motion would take it deeper.
#pragma once

#include <Eigen/Core>

#include <vector>

namespace freetalk::animation {

class Eyeball {
 public:
  /// @param points (N, 3) m, canonical frame: of the ball's surface, dense.
  /// @param skin (V, 3) m: the skin at rest.
  Eyeball(const Eigen::MatrixXd& points, const Eigen::MatrixXd& skin);

  /// Moves one frame of the skin out of the ball. @param displacements (V, 3) m, in place.
  void keep_out(float* displacements) const;

 private:
  double radius(const Eigen::Vector3d& direction) const;

  Eigen::Vector3d centre_;
  Eigen::MatrixXd radii_;  // by x and y of the direction
  struct Guarded {
    int vertex;
    Eigen::Vector3d rest;
    double above;  // m
  };
  std::vector<Guarded> guarded_;
};

/// (N, 3) points of a surface, about 0.3 mm apart: of the faces whose vertices are chosen, (V,).
Eigen::MatrixXd dense_points(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                             const std::vector<bool>& chosen);

}  // namespace freetalk::animation
