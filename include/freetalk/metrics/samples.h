// Scores of K samples generated for the same audio. N audio signals, K samples each.
#pragma once

#include <ATen/core/Tensor.h>

#include "freetalk/metrics/selection.h"

namespace freetalk::metrics {

/// D_i = 1/K sum_j sum_(l != j) |e_ij - e_il|_2 [FaceTalk Eq. 20; its D is the mean over i]. The
/// norm runs over everything behind K. It grows with K and with the length of the codes: compare
/// equal ones only.
/// @param codes (N, K, ...) float. @returns (N,) float64.
at::Tensor diversity(const at::Tensor& codes);

/// Mean over pairs of samples, valid frames and vertices of |p_jtv - p_ltv|; independent of K.
/// [FaceDiffuser's evaluation] @param samples (N, K, T, V, 3). @param selection valid is (N, T).
at::Tensor diversity_vertex(const at::Tensor& samples, const Selection& selection = {});

/// Mean estimate error: LVE of the mean of the K samples. [ProbTalk3D]
/// @param samples (N, K, T, V, 3). @param target (N, T, V, 3).
at::Tensor lve_mean_estimate(const at::Tensor& samples, const at::Tensor& target,
                             const Selection& selection = {});

/// Coverage error: least LVE of the K samples. [ProbTalk3D]
at::Tensor lve_coverage(const at::Tensor& samples, const at::Tensor& target,
                        const Selection& selection = {});

}  // namespace freetalk::metrics
