// Kernels of a supernodal L D L^T: the elimination of a dense front, and solves with what it
// leaves.
//
// A front is a symmetric matrix, its upper half stored by rows; a row's start lies on a cache line
// and has room for two more vectors. A panel is the part of L^T that the elimination of a front's
// first `width` rows gives: (width, size), row p holds L(j, p) at j.
#pragma once

#include <cstdint>

namespace freetalk::kernels {

struct Front {
  double* data;
  int64_t stride, size;
};

/// Doubles between rows of a front of this size.
constexpr int64_t front_stride(int64_t size) { return (size + 7) / 8 * 8 + 8; }

struct LdltKernels {
  /// Eliminates rows [begin, end) among themselves. @param panel of the whole front.
  void (*eliminate)(const Front& front, int64_t begin, int64_t end, double* panel, double* pivots);
  /// Rows [begin, end) less what rows [first, last) contribute, which are eliminated.
  void (*update)(const Front& front, int64_t first, int64_t last, int64_t begin, int64_t end,
                 const double* panel);
  /// x (width, 8) <- the panel's triangle inverted, times x.
  void (*solve_lower)(const double* panel, int64_t size, int64_t width, double* x);
  /// The same, transposed.
  void (*solve_upper)(const double* panel, int64_t size, int64_t width, double* x);
  /// x[row[j]] -= sum over p of L(width + j, p) solved[p], rows of eight, for j in [begin, end).
  void (*scatter)(const double* panel, int64_t size, int64_t width, const double* solved,
                  const int* row, int64_t begin, int64_t end, double* x);
  /// solved[p] -= sum over j of L(width + j, p) x[row[j]] for p in [begin, end).
  void (*gather)(const double* panel, int64_t size, int64_t width, int64_t begin, int64_t end,
                 const int* row, const double* x, double* solved);
};

/// The kernels for isa().
const LdltKernels& ldlt_kernels();

}  // namespace freetalk::kernels
