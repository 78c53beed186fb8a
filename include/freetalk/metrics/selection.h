// Which vertices and frames of a batch of sequences a metric looks at.
//
// Metrics take displacements from the neutral face, (B, T, V, 3) float32 or float64 in any one unit
// of length (metres elsewhere in freetalk), and return one float64 number a sequence, (B,), in that
// unit. All but FDD depend on the difference of the two motions alone, so that absolute vertices of
// both give the same number.
#pragma once

#include <ATen/core/Tensor.h>

namespace freetalk::metrics {

/// An undefined tensor means "all of them".
struct Selection {
  at::Tensor vertices;      ///< (V,) bool, or (M,) int64 indices, distinct: the mask
  at::Tensor valid;         ///< (B, T) bool: frames that count; the others may hold anything
  at::Tensor target_valid;  ///< (B, T') bool, for DTW and DFD alone, whose two sides may differ in
                            ///< length; undefined: `valid` if T' = T, else all frames
};

}  // namespace freetalk::metrics
