// Differentiable functions on the faces of a mesh: gradients, weak divergence, Poisson solves.
#pragma once

#include <ATen/core/Tensor.h>

#include "freetalk/geometry/poisson.h"

namespace freetalk::nn {

/// What PoissonNet adds to the Laplacian's diagonal, which is singular by itself.
inline constexpr double kPoissonRegularization = 1e-6;

/// Gradients on the faces. @param x (B, V, C). @returns (B, 2F, C): X components, then Y.
at::Tensor face_gradients(const geometry::FaceOperators& faces, const at::Tensor& x);

/// Weak divergence G^T A g. @param g (B, 2F, C). @returns (B, V, C).
at::Tensor face_divergence(const geometry::FaceOperators& faces, const at::Tensor& g);

/// u with (L + regularization I) u = rhs, all right-hand sides at once, in double on the CPU. The
/// backward pass is the same solve (L is symmetric), to any order.
/// @param rhs (B, V, C). @returns (B, V, C) of rhs's dtype, on its device.
at::Tensor poisson_solve(const geometry::FaceOperators& faces, const at::Tensor& rhs,
                         double regularization = kPoissonRegularization);

/// Mean over the corners of each face. @param x (B, V, C). @returns (B, F, C).
at::Tensor vertices_to_faces(const at::Tensor& x, const at::Tensor& faces);

}  // namespace freetalk::nn
