// Vertex metrics by name: what each measures, in which unit, over which mask, and who defined it.
#pragma once

#include <ATen/core/Tensor.h>

#include <string>
#include <vector>

#include "freetalk/metrics/selection.h"

namespace freetalk::metrics {

struct MetricInfo {
  std::string name;
  std::string title;    ///< as tables print it
  std::string mask;     ///< where it is measured: "lips", "upper" or "all"
  std::string unit;     ///< "m", "m^2", "m^2/s^6" or "1", motion being in metres
  std::string pooling;  ///< a test set's number: the mean over all its "frames" or over "sequences"
  double ideal = 0;     ///< what a perfect prediction scores
  bool two_sided = false;  ///< values on both sides of `ideal` are possible: nearer to it is better
  std::string formula;
  std::string source;
};

/// In the order in which tables print them.
const std::vector<MetricInfo>& vertex_metrics();

/// @throws std::invalid_argument naming the nearest known name.
const MetricInfo& metric_info(const std::string& name);

/// The metric `name` of each sequence, (B,) float64. @param fps used by jerk_energy alone.
at::Tensor vertex_metric(const std::string& name, const at::Tensor& pred, const at::Tensor& target,
                         double fps, const Selection& selection = {});

}  // namespace freetalk::metrics
