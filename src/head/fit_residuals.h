// Signed distances of points and their derivatives in the codes, a row for each point.
#pragma once

#include <ATen/core/Tensor.h>

#include <vector>

#include "freetalk/head/parametric_head.h"

namespace freetalk::head {

/// s (P,) and ds / dcodes (P, C), in head units.
struct Linearized {
  at::Tensor distance, jacobian;
};

/// In z_exp, of points (P, 3) in head units. @param z_id (identity_dim,). @param z_exp (E,).
Linearized linearize_expression(ParametricHeadImpl& head, const at::Tensor& points,
                                const at::Tensor& z_id, const at::Tensor& z_exp);
/// In [z_id | z_exp].
Linearized linearize_both(ParametricHeadImpl& head, const at::Tensor& points,
                          const at::Tensor& z_id, const at::Tensor& z_exp);

/// The points of a frame in head units: at most `count` of them, 0 for all.
at::Tensor draw_points(const at::Tensor& points, int64_t count, double units_per_metre,
                       at::Generator& generator);
/// Refuses empty frames and what is not finite.
void check_frames(const std::vector<at::Tensor>& points);

}  // namespace freetalk::head
