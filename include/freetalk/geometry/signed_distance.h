// Distances to a triangle mesh: nearest points through a tree of boxes, the sign from the
// generalised winding number (Jacobson, Kavan & Sorkine-Hornung 2013), which parts that overlap,
// small gaps and turned-in folds leave right. Far parts of the mesh enter the winding number by
// their first two moments (Barill et al., "Fast winding numbers for soups and clouds", 2018).
#pragma once

#include <Eigen/Core>

#include <memory>

namespace freetalk::geometry {

/// The nearest points of a surface.
struct NearestOnSurface {
  Eigen::MatrixXd points;     ///< (N, 3)
  Eigen::VectorXd distances;  ///< (N,) >= 0
  Eigen::VectorXi faces;      ///< (N,) the triangle each lies on, the first of those as near
};

/// A triangle mesh made ready for many points. Immutable, shared by threads.
class SurfaceTree {
 public:
  /// @param vertices (V, 3) finite. @param faces (F, 3) in range, at least one; outward.
  /// @throws std::invalid_argument for no faces, indices out of range, vertices that are not
  /// finite.
  SurfaceTree(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces);
  ~SurfaceTree();
  SurfaceTree(SurfaceTree&&) noexcept;
  SurfaceTree& operator=(SurfaceTree&&) noexcept;

  /// @param points (N, 3).
  NearestOnSurface nearest(const Eigen::MatrixXd& points) const;

  /// (N,) how often the surface winds around each point: 1 inside a closed one, 0 outside, 2 where
  /// two overlap. @param points (N, 3). @param accuracy a part of the mesh farther away than this
  /// many of its radii enters by its moments: 2 is good to .01, infinity exact; >= 1.
  Eigen::VectorXd winding_number(const Eigen::MatrixXd& points, double accuracy = 2.0) const;

  /// (N,) distance, negative where the winding number is at least 1/2. @param points (N, 3).
  Eigen::VectorXd signed_distance(const Eigen::MatrixXd& points) const;

 private:
  struct Tree;
  std::unique_ptr<const Tree> tree_;
};

/// Signed distances of points (N, 3) to a mesh, see SurfaceTree.
Eigen::VectorXd signed_distance(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                const Eigen::MatrixXd& points);

}  // namespace freetalk::geometry
