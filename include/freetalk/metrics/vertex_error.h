// Distances between corresponding vertices, frame by frame. p, g: prediction and ground truth;
// v: vertices of the mask; t: valid frames.
#pragma once

#include "freetalk/metrics/selection.h"

namespace freetalk::metrics {

/// LVE = mean_t max_v |p_tv - g_tv|^2, squared unit, mask: lips. [CodeTalker, FaceDiffuser,
/// ScanTalk and torchmetrics; FreeTalk 4.1 says "maximum L2 error"]
at::Tensor lve(const at::Tensor& pred, const at::Tensor& target, const Selection& selection = {});

/// mean_t max_v |p_tv - g_tv|, mask: lips. [FreeTalk 4.1 to the letter]
at::Tensor lve_l2(const at::Tensor& pred, const at::Tensor& target,
                  const Selection& selection = {});

/// MVE = mean_t mean_v |p_tv - g_tv|. [FaceDiffuser, ScanTalk; the numbers of FreeTalk's tables]
at::Tensor mve_mean(const at::Tensor& pred, const at::Tensor& target,
                    const Selection& selection = {});

/// mean_t max_v |p_tv - g_tv| over the whole face. [FreeTalk 4.1 to the letter]
at::Tensor mve_max(const at::Tensor& pred, const at::Tensor& target,
                   const Selection& selection = {});

}  // namespace freetalk::metrics
