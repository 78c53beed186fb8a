// Operators of triangle meshes: cotangent Laplacian, lumped mass, gradient. V (V, 3) double, F (F,
// 3) int throughout; faces may be degenerate, repeated, non-manifold; vertices unreferenced.
#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCore>

#include <cstdint>
#include <vector>

namespace freetalk::geometry {

using SparseMatrix = Eigen::SparseMatrix<double>;
using RowSparseMatrix = Eigen::SparseMatrix<double, Eigen::RowMajor>;

/// How divisions by small numbers are guarded.
enum class Regularization {
  kRelative,  ///< Relative to each element's own size: operators follow a uniform scale exactly.
  kAbsolute,  ///< The absolute constants of the public `diffusion_net` package (1e-10 in
              ///< cotangents, 1e-5 in gradients, 1e-6 in operators' normals): parity with it.
};

/// (V, V) cotangent Laplacian, positive semi-definite: L_ij = -(cot a_ij + cot b_ij) / 2, rows sum
/// to zero. All of the diagonal is stored, that of vertices without faces too.
SparseMatrix cotan_laplacian(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                             Regularization regularization = Regularization::kRelative);

/// (V,) a third of the area of the faces around, plus 1e-8 of the mean so that none is zero.
Eigen::VectorXd lumped_mass(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces);

/// (V, 9) row-major 3x3 frames, rows X, Y, N: X is the world's X (Y where |n_x| >= 0.9) made
/// tangent, Y = N x X.
Eigen::MatrixXd tangent_frames(const Eigen::MatrixXd& normals);

/// (2V, V) gradient in the tangent frames, rows 0..V-1 the X and V..2V-1 the Y component: per
/// vertex the least squares fit of a linear function to the differences along its edges, (EtE + e
/// I)^-1 Et.
RowSparseMatrix vertex_gradient(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                const Eigen::MatrixXd& frames,
                                Regularization regularization = Regularization::kRelative);

}  // namespace freetalk::geometry
