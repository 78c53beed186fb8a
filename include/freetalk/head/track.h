// A parametric head as a mesh of fixed topology: canonical points that an expression moves. The
// template is an extracted canonical surface, a face model's mesh, or a user's own mesh, brought to
// canonical space from its rest pose.
#pragma once

#include <ATen/core/Tensor.h>

#include <functional>
#include <vector>

#include "freetalk/head/prepared_head.h"
#include "freetalk/head/smoothing.h"

namespace freetalk::head {

struct TrackOptions {
  /// Newton steps on the backward network's residual at the refined vertices; 0: none. Lips and
  /// lids touch where the deformation jumps, and the residual puts them on their own side.
  int64_t newton_steps = 1;
  double largest_step_mm = 1.0;  // longer steps jump to another sheet and are left out
  template <class V>
  void fields(V& v) {
    v("newton_steps", newton_steps);
    v("largest_step_mm", largest_step_mm);
  }
  void check() const;
};

/// Called with frames done and frames in all; it may throw to stop.
using FrameCallback = std::function<void(int64_t, int64_t)>;

/// @param template_points (V, 3) canonical, metres. @param z_exp (T, expression_dim).
/// @param refined vertices that Newton's method refines; empty: none.
/// @returns (T, V, 3) float32, metres, posed.
at::Tensor track(const PreparedHead& head, const at::Tensor& template_points,
                 const at::Tensor& z_exp, const std::vector<int64_t>& refined = {},
                 const TrackOptions& options = {}, const SmoothingOptions& smoothing = {},
                 const FrameCallback& on_frame = {});

/// A posed mesh in canonical space. @param vertices (V, 3) metres. @param z_exp (expression_dim,)
/// of its pose; undefined: the head's rest_expression. @returns (V, 3) float32, metres.
at::Tensor canonical_template(const PreparedHead& head, const at::Tensor& vertices,
                              const at::Tensor& z_exp = {});

}  // namespace freetalk::head
