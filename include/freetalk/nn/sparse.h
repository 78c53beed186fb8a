// Sparse times dense over many frames at once, with a backward pass that never forms a dense V x V.
#pragma once

#include <ATen/core/Tensor.h>

namespace freetalk::nn {

/// y_b = A x_b for all b.
/// @param matrix (R, V) sparse CSR, constant. @param transposed its transpose (V, R) sparse CSR,
/// for the backward
///   pass. @param x (B, V, C), any device, dtype of the matrix (autocast's lower precisions are
///   computed in it).
/// @returns (B, R, C).
at::Tensor sparse_product(const at::Tensor& matrix, const at::Tensor& transposed,
                          const at::Tensor& x);

}  // namespace freetalk::nn
