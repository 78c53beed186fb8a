#include "point_cloud_operators.h"

#include <ATen/ATen.h>

#include <algorithm>

#include "freetalk/core/error.h"
#include "freetalk/geometry/eigenbasis.h"
#include "freetalk/geometry/robust_laplacian.h"
#include "freetalk/geometry/surface.h"
#include "laplacian_by_name.h"
#include "tensor_conversion.h"

namespace freetalk::geometry {

SurfaceOperators point_cloud_operators(const Eigen::MatrixXd& points,
                                       const OperatorOptions& options, const std::string& name,
                                       const std::function<void(double)>& progress) {
  FREETALK_CHECK(points.rows() > 3, "operators of the point cloud ", name,
                 " need at least 4 points, found ", points.rows());
  const int64_t num_neighbors = std::min<int64_t>(30, points.rows() - 1);
  PointCloudTriangles cloud = triangulate_point_cloud(points, num_neighbors);
  FREETALK_CHECK(cloud.triangles.rows() > 0, "operators of the point cloud ", name,
                 " need points on a surface; all of them lie on one line or in one place");
  const LaplacianAndMass robust = point_cloud_laplacian(points, cloud);
  const Eigen::VectorXd mass = with_floor(robust.mass);
  const Eigenbasis basis = eigenbasis(
      robust.laplacian, mass, {options.k_eig, options.residual_tolerance, "auto"}, name, progress);
  orient_normals(points, cloud.neighbors, cloud.normals);
  const Eigen::MatrixXd frames = tangent_frames(cloud.normals);
  const RowSparseMatrix gradient =
      vertex_gradient(points, cloud.triangles, frames, regularization_of(options));
  SurfaceOperators operators;
  operators.mass = to_tensor(mass).squeeze(1);
  operators.evals = to_tensor(basis.evals).squeeze(1);
  operators.evecs = to_tensor(basis.evecs);
  operators.residuals = to_tensor(basis.residuals).squeeze(1);
  operators.normals = to_tensor(cloud.normals);
  operators.frames = to_tensor(frames).view({points.rows(), 3, 3});
  operators.gradients = to_sparse_operator(gradient);
  return operators;
}

}  // namespace freetalk::geometry
