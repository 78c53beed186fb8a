// Distances between trajectories that may be stretched in time; mask: lips. Prediction (B, T, V, 3)
// and ground truth (B, T', V, 3) may differ in length.
//
// The distance of two frames is d(t, s) = mean_v |p_tv - g_sv|. A path couples (0, 0) to
// (T - 1, T' - 1) in steps (1, 0), (0, 1), (1, 1). FreeTalk 4.1 gives prose only ("DTW and DFD over
// lip vertex trajectories"); normalisation and d are ours. Time O(T T' M), memory O(T' M).
#pragma once

#include "freetalk/metrics/selection.h"

namespace freetalk::metrics {

/// DTW: least sum of d along a path, divided by T' (the mean cost of a frame of the ground truth).
at::Tensor dtw(const at::Tensor& pred, const at::Tensor& target, const Selection& selection = {});

/// The same sum, not divided. [Sakoe and Chiba 1978]
at::Tensor dtw_sum(const at::Tensor& pred, const at::Tensor& target,
                   const Selection& selection = {});

/// As dtw, but each vertex is warped by itself: mean_v DTW of its own trajectory.
at::Tensor dtw_vertex(const at::Tensor& pred, const at::Tensor& target,
                      const Selection& selection = {});

/// DFD, discrete Frechet distance: least maximum of d along a path. [Eiter and Mannila 1994]
at::Tensor dfd(const at::Tensor& pred, const at::Tensor& target, const Selection& selection = {});

/// As dfd, but of each vertex by itself: mean_v DFD of its own trajectory.
at::Tensor dfd_vertex(const at::Tensor& pred, const at::Tensor& target,
                      const Selection& selection = {});

}  // namespace freetalk::metrics
