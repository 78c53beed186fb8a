// The identity field of a prepared head on a grid, asked where it is first needed and interpolated
// by cubic convolution [Keys 1981] since.
#pragma once

#include "freetalk/head/prepared_head.h"
#include "head/lattice.h"

namespace freetalk::head {

class CanonicalGrid {
 public:
  /// @param cells along each axis of the head's box.
  CanonicalGrid(const PreparedHead& head, int64_t cells);

  /// Unfaded distances (N,) at canonical points (N, 3); beyond the grid the field itself.
  at::Tensor sdf(const at::Tensor& points);
  /// Points at which the field was asked so far.
  int64_t num_evaluations() const { return num_evaluations_; }

 private:
  /// The lower corner of a point's cell and the place in it; false beyond the grid.
  bool locate(const float* point, int64_t* cell, float* within) const;
  void ask_missing(const float* points, int64_t count);

  const PreparedHead head_;
  double origin_[3], spacing_[3];
  Lattice lattice_;
  int64_t num_evaluations_ = 0;
};

}  // namespace freetalk::head
