// Sparse times dense over many frames at once, with a backward pass that never forms a dense V x V.
#pragma once

#include <ATen/core/Tensor.h>

#include "freetalk/geometry/sparse_operator.h"

namespace freetalk::nn {

/// y_b = A x_b for all b: the operation freetalk::sparse_product of torch's dispatcher, which is
/// differentiable in x to any order, leaves autocast (the product runs in the matrix's dtype),
/// traces under torch.compile, and runs on the CPU and on every device with sparse CSR products.
/// @param matrix (R, V). @param x (B, V, C), converted to the matrix's dtype; on its device.
/// @returns (B, R, C) of the matrix's dtype.
/// @throws std::invalid_argument the shapes do not fit.
at::Tensor sparse_product(const geometry::SparseOperator& matrix, const at::Tensor& x);

}  // namespace freetalk::nn
