// Can the emotion be read from the face? A classifier fitted to recorded motion labels generated
// motion.
#pragma once

#include <ATen/core/Tensor.h>

#include <string>
#include <vector>

#include "freetalk/metrics/selection.h"

namespace freetalk::metrics {

/// Mean and standard deviation (ddof 0) over valid frames of each coordinate of the mask's
/// vertices; mask: upper face. @param motion (B, T, V, 3). @returns (B, 2 * 3M) float64, the
/// motion's unit.
at::Tensor affect_features(const at::Tensor& motion, const Selection& selection = {});

/// Labels a feature vector by the nearest class mean, each feature divided by its spread within the
/// classes plus `floor`.
class NearestCentroid {
 public:
  /// @param features (N, F) float. @param labels N class names. @param floor in the features' unit.
  NearestCentroid(const at::Tensor& features, const std::vector<std::string>& labels, double floor);

  /// @param features (N, F). @returns N class names.
  std::vector<std::string> predict(const at::Tensor& features) const;
  /// Sorted.
  const std::vector<std::string>& classes() const { return classes_; }

 private:
  std::vector<std::string> classes_;
  at::Tensor centroids_, spread_;  // (C, F), (F,) float64
};

/// Recognisability of each sequence: is its label what a classifier reads that was fitted to all
/// *other* sequences of `reference`? @param features, reference (N, F), row i of the one generated
/// for, of the other recorded in, sequence i. @param labels N class names, two of each at least.
std::vector<bool> recognised(const at::Tensor& features, const at::Tensor& reference,
                             const std::vector<std::string>& labels, double floor);

}  // namespace freetalk::metrics
