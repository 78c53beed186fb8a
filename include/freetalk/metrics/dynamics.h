// How vertices move: spread over time, displacement from frame to frame, jerk. p, g: displacements
// from the neutral face of prediction and ground truth; v: vertices of the mask; t: valid frames.
// u_tv = p_(t+1)v - p_tv and w_tv = g_(t+1)v - g_tv count where both frames are valid.
#pragma once

#include "freetalk/metrics/selection.h"

namespace freetalk::metrics {

/// FDD = mean_v [std_t |g_tv|^2 - std_t |p_tv|^2], ddof 0, squared unit, signed: above 0, the
/// prediction moves too little. Mask: upper face. [CodeTalker, FaceDiffuser, ScanTalk]
at::Tensor fdd(const at::Tensor& pred, const at::Tensor& target, const Selection& selection = {});

/// |FDD| of each sequence. [FaceDiffuser, ScanTalk: "ABS FDD"]
at::Tensor fdd_abs(const at::Tensor& pred, const at::Tensor& target,
                   const Selection& selection = {});

/// delta_M = mean_t mean_v |u_tv - w_tv|^2, squared unit a frame step. [FreeTalk 4.1: "mean squared
/// displacement error", prose only; the formula is ours]
at::Tensor delta_m(const at::Tensor& pred, const at::Tensor& target,
                   const Selection& selection = {});

/// mean_t mean_v |u_tv - w_tv|. [FreeTalk 4.1: "error magnitude"; the formula is ours]
at::Tensor delta_m_l2(const at::Tensor& pred, const at::Tensor& target,
                      const Selection& selection = {});

/// delta_Cd = mean_t mean_v 1 - cos(u_tv, w_tv), in [0, 2]; 1 where u or w alone is exactly 0, 0
/// where both are, near 1 on average where they are noise. [FreeTalk 4.1: prose only; formula ours]
at::Tensor delta_cd(const at::Tensor& pred, const at::Tensor& target,
                    const Selection& selection = {});

/// As delta_cd, but each vertex and step counts in proportion to its true motion:
/// sum |w| (1 - cos(u, w)) / sum |w|; 0 where nothing moves. What stands still has no direction.
at::Tensor delta_cd_weighted(const at::Tensor& pred, const at::Tensor& target,
                             const Selection& selection = {});

/// Jerk energy of one motion: mean_t mean_v |(m_(t+3) - 3 m_(t+2) + 3 m_(t+1) - m_t) fps^3|^2,
/// unit^2 / s^6, over runs of four valid frames.
at::Tensor jerk_energy(const at::Tensor& motion, double fps, const Selection& selection = {});

/// Jitter: jerk energy of the prediction over that of the ground truth; 1: equally smooth; infinite
/// where only the ground truth is perfectly smooth, 1 where both are.
at::Tensor jitter_ratio(const at::Tensor& pred, const at::Tensor& target,
                        const Selection& selection = {});

}  // namespace freetalk::metrics
