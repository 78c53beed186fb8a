// Functions on the faces of a triangle mesh: gradients, divergence and the Poisson equation.
//
//   (G u)_f     the constant gradient of the linear interpolant, in the tangent frame of face f
//   G^T A g     the weak divergence of a field g on the faces, A the face areas
//   L = G^T A G the cotangent Laplacian;  u = argmin sum_f A_f |(G u)_f - g_f|^2  solves
//   L u = G^T A g
//
// Used by PoissonNet [Maesumi et al. 2025] and Neural Jacobian Fields [Aigerman et al. 2022].
#pragma once

#include <ATen/core/Tensor.h>
#include <Eigen/Core>

#include <map>
#include <memory>
#include <mutex>
#include <vector>

#include "freetalk/geometry/sparse_cholesky.h"
#include "freetalk/geometry/sparse_operator.h"
#include "freetalk/geometry/surface.h"

namespace freetalk::geometry {

/// L + regularization I, each regularization factored once, when first used.
class PoissonSolver {
 public:
  explicit PoissonSolver(SparseMatrix laplacian) : laplacian_(std::move(laplacian)) {}

  /// @param rhs (V, R) float64 on the CPU, contiguous. @param regularization > 0: the Laplacian
  ///   alone is singular, once per connected part. @returns (V, R).
  at::Tensor solve(const at::Tensor& rhs, double regularization) const;

  const SparseMatrix& laplacian() const { return laplacian_; }
  int64_t num_vertices() const { return laplacian_.rows(); }

 private:
  SparseMatrix laplacian_;
  mutable std::mutex mutex_;
  mutable std::map<double, std::shared_ptr<const SparseCholesky>> factors_;
};

/// What lives on the faces of one mesh, or of several laid one after the other.
struct FaceOperators {
  at::Tensor faces;          ///< (F, 3) int64
  at::Tensor areas;          ///< (F,) length^2
  SparseOperator gradients;  ///< (2F, V) 1 / length: X components, then Y
  at::Tensor frames;         ///< (F, 3, 3) rows X, Y, normal; zero for degenerate faces
  at::Tensor components;     ///< (V,) int64, connected part of each vertex, from 0
  int64_t num_components = 0;
  std::vector<std::shared_ptr<const PoissonSolver>> solvers;  ///< of each mesh

  /// Of the same surface scaled uniformly, turned by a rotation (3, 3), converted.
  FaceOperators scaled(double factor) const;
  FaceOperators turned(const at::Tensor& rotation) const;
  FaceOperators to(at::ScalarType dtype, const c10::Device& device) const;
};

/// @param vertices (V, 3). @param faces (F, 3); degenerate faces have gradient zero.
/// @param vertex_of (V,) welded vertex of each (see weld.h): the vertices of one spot count as one,
///   whose value is their mean. Empty: all are apart.
/// @returns float64 on the CPU; the Poisson system is factored when it is first solved.
FaceOperators face_operators(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                             const Eigen::VectorXi& vertex_of = {});

/// Several meshes laid one after the other: vertex and face indices are shifted.
FaceOperators concatenate(const std::vector<const FaceOperators*>& parts);

/// Unique undirected edges (i < j) in lexicographic order. @param faces (F, 3) int64.
/// @returns (E, 2) int64 on the CPU.
at::Tensor unique_edges(const at::Tensor& faces);

}  // namespace freetalk::geometry
