// Kernels of the fused decoder: matrix products of row tiles with packed operands and the
// element-wise passes between them, one table for each instruction set and element type.
//
// T is float, or uint16_t for bfloat16 bits. G, the group, is the number of consecutive inner
// indices that one instruction multiplies and adds: 1 for float, 2 for bfloat16.
//   rows     (n, K) row-major T
//   packed   (K, n) as [n / panel][K / G][panel][G]: the right operand of a product
//   grouped  (n, C) as [n / G][C][G]: the operands of a product over the rows
#pragma once

#include <cstdint>

namespace freetalk::kernels {

/// Tile heights are multiples of both kernels' register blocks.
inline constexpr int64_t kTile = 96;

template <class T>
struct Segment {
  const T* a;      // rows
  int64_t stride;  // of a
  const T* b;      // packed
  int64_t k;       // inner size, a multiple of G
};

/// What happens to a product before it is stored.
struct Epilogue {
  const float* bias = nullptr;      // (columns,)
  const float* residual = nullptr;  // rows, stride of the result
  bool relu = false;
};

template <class T>
struct Kernels {
  int64_t panel;
  int64_t group;
  /// result = sum over segments of a b, with the epilogue; stored as float, as T, or both.
  void (*product)(const Segment<T>* segments, int64_t count, int64_t rows, int64_t columns,
                  const Epilogue& epilogue, float* as_float, T* as_element, int64_t stride);
  /// sums (K, C) += basis^T x over `rows` rows, both grouped; K a multiple of 8, C of the panel.
  void (*accumulate)(const T* basis, const T* x, int64_t rows, int64_t k, int64_t columns,
                     float* sums);
  /// z = tanh(x_X (u_X - w_Y) + x_Y (u_Y + w_X)), where _X and _Y are components of gradients.
  /// @param fields (rows, 6 panel): a panel of columns of x_X, u_X, w_X, x_Y, u_Y, w_Y each.
  /// @param z a panel of columns of rows with this stride.
  void (*gradient_features)(int64_t rows, const float* fields, T* z, int64_t stride);
  /// Softmax over the first `count` of each row's scores; the rest of the result is not touched.
  void (*softmax)(const float* scores, int64_t rows, int64_t stride, int64_t count, T* result);
  void (*convert)(const float* x, int64_t count, T* result);
  /// Rows to grouped; a missing last row of a group counts as zero.
  void (*group_rows)(const float* x, int64_t rows, int64_t columns, T* result);
  /// (K, columns) row-major float to packed; rows beyond k up to a group count as zero.
  void (*pack)(const float* b, int64_t k, int64_t columns, T* result);
  /// result (rows, outputs) = x w^T + bias. @param w (outputs, columns).
  void (*project)(const float* x, int64_t rows, int64_t columns, const float* w, const float* bias,
                  int64_t outputs, float* result);
  /// x = log(1 + exp(beta x)) / beta. @param count a multiple of the panel.
  void (*softplus)(float* x, int64_t count, float beta);
};

/// The kernels for isa().
const Kernels<float>& float_kernels();
/// Null below avx512_bf16.
const Kernels<uint16_t>* bfloat16_kernels();

}  // namespace freetalk::kernels
