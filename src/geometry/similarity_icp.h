// Scoring and refining a similarity between two oriented point sets, robust to parts that only one
// of them has.
#pragma once

#include <Eigen/Core>

#include "freetalk/geometry/alignment.h"
#include "mesh/kd_tree.h"

namespace freetalk::geometry {

struct IcpProblem {
  const mesh::KdTree& source;  ///< the mesh, its own frame
  const mesh::KdTree& target;  ///< the template, metres
  double target_spacing;       ///< mean distance between neighbouring template points
  double scale_prior = 0;      ///< expected scale, 0 for none
};

struct IcpSettings {
  int iterations = 10;
  double reach_begin_m = 0.030;  ///< truncation distance of the first iteration
  double reach_end_m = 0.015;    ///< and of the last
  int num_target = 300;          ///< template points used
  int num_source = 0;            ///< mesh points used in the other direction
};

/// Truncated squared distances, mean over both directions, 0 (perfect) .. 1 (nothing matches).
double fit_score(const IcpProblem& problem, const Similarity& guess, double reach_m, int num_target,
                 int num_source);

/// Point-to-plane ICP with scale from `guess`.
Similarity refine(const IcpProblem& problem, const Similarity& guess, const IcpSettings& settings);

struct FitQuality {
  double residual_m;      ///< mean distance to the mesh
  double normal_degrees;  ///< mean angle between the normals
};

/// Over the best 85 % of the template's middle (within 8 cm of its origin); points without a mesh
/// point in reach count as 25 mm and 60 degrees.
FitQuality fit_quality(const IcpProblem& problem, const Similarity& fit);

}  // namespace freetalk::geometry
