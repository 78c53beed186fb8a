// The tufted Laplacian of Sharp & Crane, "A Laplacian for Nonmanifold Triangle Meshes" (SGP 2020):
// intrinsic mollification, a manifold double cover of the triangles, intrinsic Delaunay flips. It
// is a Laplacian with non-negative edge weights for any triangles: non-manifold, open,
// inconsistently oriented, without area; and for point clouds. Values agree with the package
// `robust_laplacian`.
#pragma once

#include <Eigen/Core>

#include <cstdint>

#include "freetalk/geometry/surface.h"

namespace freetalk::geometry {

/// The smallest mollification, in mean edge lengths, by which every triangle inequality holds after
/// it (delta in Section 4.5 of the paper); 0 switches it off.
inline constexpr double kMollifyFactor = 1e-5;

/// A Laplacian and its mass.
struct LaplacianAndMass {
  SparseMatrix laplacian;  ///< (V, V) positive semi-definite, rows sum to zero.
  Eigen::VectorXd mass;    ///< (V,) lumped, length^2, positive.
};

/// The tufted Laplacian of triangles. Vertices in no face get 1 on the diagonal of the Laplacian, a
/// thousandth of the smallest mass, and thereby an eigenvalue far above those of the surface.
/// @param vertices (V, 3). @param faces (F, 3). @param mollify_factor see kMollifyFactor.
/// @throws std::invalid_argument for wrong shapes, indices out of range, coordinates that are not
///   finite, no faces, all edges of length zero.
LaplacianAndMass robust_laplacian(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                  double mollify_factor = kMollifyFactor);

/// How the neighbourhoods of a point cloud are fitted.
enum class CloudFit {
  kPublished,  ///< As the package `robust_laplacian` 1.1 does: its planes lean towards the origin
               ///< (the mean divides by one too many), and it takes a boundary point whose gap lies
               ///< across the tangent x-axis for an inner one. Parity with it.
  kExact,      ///< The mean itself, every gap: follows a rotation and a translation of the points.
};

/// Triangles between each point and its neighbours: the Delaunay triangles around the point of its
/// nearest neighbours, projected to their plane of least squares (Section 5.7 of the paper). A
/// triangle three points agree on appears three times.
struct PointCloudTriangles {
  Eigen::MatrixXi triangles;  ///< (T, 3) rows begin with the point whose neighbourhood it is.
  Eigen::MatrixXd normals;    ///< (V, 3) unit, of those planes; their signs are not consistent.
  Eigen::MatrixXi neighbors;  ///< (V, num_neighbors) nearest first, without the point itself.
};

/// @param points (V, 3). @param num_neighbors 3 .. V - 1.
/// @throws std::invalid_argument for wrong shapes, coordinates that are not finite, a
///   `num_neighbors` out of range.
PointCloudTriangles triangulate_point_cloud(const Eigen::MatrixXd& points, int64_t num_neighbors,
                                            CloudFit fit = CloudFit::kExact);

/// The tufted Laplacian of a point cloud: that of `triangulate_point_cloud`, divided by three.
/// @throws as triangulate_point_cloud and robust_laplacian.
LaplacianAndMass point_cloud_laplacian(const Eigen::MatrixXd& points,
                                       double mollify_factor = kMollifyFactor,
                                       int64_t num_neighbors = 30, CloudFit fit = CloudFit::kExact);

/// The same of points already triangulated.
LaplacianAndMass point_cloud_laplacian(const Eigen::MatrixXd& points,
                                       const PointCloudTriangles& cloud,
                                       double mollify_factor = kMollifyFactor);

/// Turns normals so that neighbouring ones agree, along a minimum spanning tree of their angles
/// (Hoppe et al. 1992), outwards at the point farthest from the mean of each connected part.
/// @param points (V, 3). @param neighbors (V, N). @param normals (V, 3) unit, turned in place.
void orient_normals(const Eigen::MatrixXd& points, const Eigen::MatrixXi& neighbors,
                    Eigen::MatrixXd& normals);

}  // namespace freetalk::geometry
