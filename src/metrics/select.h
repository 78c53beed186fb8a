// What a selection leaves of a batch, checked and in double precision.
#pragma once

#include <ATen/core/Tensor.h>

#include <string>

#include "freetalk/metrics/selection.h"

namespace freetalk::metrics {

/// Checks that `motion` is (B, T, V, 3) floating point with B, T, V >= 1.
void check_motion(const at::Tensor& motion, const std::string& metric, const char* name);

/// The mask as int64 indices on the motion's device, or undefined for all vertices.
at::Tensor vertex_indices(const Selection& selection, const at::Tensor& motion,
                          const std::string& metric);

/// (B, T) bool, all true where undefined. Every sequence keeps a run of `run` valid frames at
/// least.
at::Tensor valid_frames(const at::Tensor& valid, const at::Tensor& motion, int64_t run,
                        const std::string& metric);

/// The mask's vertices, (B, T, M, 3) float64.
at::Tensor take_vertices(const at::Tensor& motion, const at::Tensor& indices);

struct Motions {
  at::Tensor pred, target;  // (B, T, M, 3) float64
  at::Tensor valid;         // (B, T) bool
};

/// Both motions of equal shape under a selection; runs of `run` valid frames are needed.
Motions select_motions(const at::Tensor& pred, const at::Tensor& target, const Selection& selection,
                       int64_t run, const std::string& metric);

/// (B, T - run + 1): the frames from which `run` frames are valid.
at::Tensor valid_runs(const at::Tensor& valid, int64_t run);

/// Mean over valid frames of (B, T) values, or of (B, T, ...) along T. Invalid frames may hold NaN.
at::Tensor mean_over_frames(const at::Tensor& values, const at::Tensor& valid);

/// (..., 3) -> (...), the square of the length.
at::Tensor squared_length(const at::Tensor& vectors);

}  // namespace freetalk::metrics
