// Facial smoothing [FaceTalk Eq. 11-15]: the deformation keeps its strength at the face and loses
// it towards ears and neck, which no expression moves.
//
//   d(p) = |(p - C) / Sigma|,  g(p) = exp(-d(p)^2 / 2),  w = (g - min g) / (max g - min g)
//
// "published" is the paper's: delta^s = w delta, with min and max over the head's box. It also
// weakens blinks, and where delta is 0 the canonical mouth is open. "rest" keeps the face whole:
// delta^s = delta_rest + w (delta - delta_rest) with w = 1 for d <= 1 and exp(-(d - 1)^2 / 2 s^2)
// beyond, so that what is not moved is at rest.
#pragma once

#include <ATen/core/Tensor.h>

#include <string>
#include <vector>

#include "freetalk/head/prepared_head.h"

namespace freetalk::head {

struct SmoothingOptions {
  std::string mode = "none";        // "none", "rest" or "published"
  std::vector<double> center = {};  // C, head units; empty: the mean of the identity's anchors
  std::vector<double> sigma = {0.35, 0.4, 0.4};  // Sigma, head units
  double falloff = 0.5;                          // s of "rest"
  template <class V>
  void fields(V& v) {
    v("mode", mode);
    v("center", center);
    v("sigma", sigma);
    v("falloff", falloff);
  }
  void check() const;
};

/// w at points (N, 3) in head units: (N,) in [0, 1].
at::Tensor smoothing_weights(const PreparedHead& head, const at::Tensor& points,
                             const SmoothingOptions& options);

/// Offsets (N, 3) or (N, C) of a deformation at points, smoothed; `at_rest` are those of
/// rest_expression.
at::Tensor smoothed_offsets(const PreparedHead& head, const at::Tensor& points,
                            const at::Tensor& offsets, const at::Tensor& at_rest,
                            const SmoothingOptions& options);

}  // namespace freetalk::head
