// The surface of a parametric head as a triangle mesh: marching cubes on a fine grid whose corners
// are asked only where the surface is.
//
// A coarse grid is pruned by |s| against a bound of the field's slope that its own values show. In
// the cells left, crossings of a lattice in between seed the fine cells, and from cell to cell
// through crossed faces the surface is followed until it is closed. Parts smaller than a cell of
// the lattice in between, and apart from all others, are left out.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "freetalk/head/prepared_head.h"
#include "freetalk/head/smoothing.h"

namespace freetalk::head {

struct SurfaceOptions {
  int64_t resolution = 256;  // cells along each axis of the head's box, a multiple of 4 coarse
  int64_t coarse = 32;       // cells of the first pass along each axis
  double safety = 1.5;       // times the steepest slope among the coarse cells near the surface
  /// Where the surface meets the head's box: "close" caps it, "open" leaves a border, "error"
  /// refuses it.
  std::string at_box = "close";
  /// In a sequence: canonical distances interpolated on a grid of the same cells, asked once.
  bool canonical_grid = true;
  template <class V>
  void fields(V& v) {
    v("resolution", resolution);
    v("coarse", coarse);
    v("safety", safety);
    v("at_box", at_box);
    v("canonical_grid", canonical_grid);
  }
  void check() const;
};

struct Surface {
  Eigen::MatrixXd vertices;  // (V, 3) metres
  Eigen::MatrixXi faces;     // (F, 3), turned outward
  int64_t num_evaluations;   // points at which the field was asked
};

/// Extracts surfaces of one identity. A sequence begins each frame from the cells of the last one;
/// the surface is the same, but for parts that appear apart from all others. Not to be used from
/// several threads at a time.
class SurfaceExtractor {
 public:
  explicit SurfaceExtractor(const PreparedHead& head, const SurfaceOptions& options = {},
                            const SmoothingOptions& smoothing = {});
  ~SurfaceExtractor();
  SurfaceExtractor(SurfaceExtractor&&) noexcept;

  /// @param z_exp (expression_dim,). @throws std::runtime_error where there is no surface within
  /// the box, or it leaves it and may not.
  Surface extract(const at::Tensor& z_exp);
  /// The next frame of a sequence.
  Surface next(const at::Tensor& z_exp);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace freetalk::head
