// Weights of shapes that explain landmark motion:
//
//   min |A w - l|^2 + l2 |w|^2 + l1 sum w + lt |w - w_before|^2
//       + ls sum_(left, right) (w_left - w_right)^2 + lc sum_(a, b) w_a w_b,    0 <= w <= 1,
//
// by coordinate descent on the Gram matrix, from the weights of the frame before. The terms are
// those of Audio2Face-3D's solver.
#pragma once

#include <Eigen/Core>

#include <string>
#include <vector>

#include "freetalk/rig/face_rig.h"

namespace freetalk::rig {

class ShapeSolver {
 public:
  /// @param shapes (D, S) mm, one shape a column.
  ShapeSolver(const Eigen::MatrixXd& shapes, const std::vector<std::string>& names,
              const RigOptions& options);

  /// @param landmarks (D,) mm. @param weights (S,) those of the frame before; replaced.
  void solve(const Eigen::VectorXd& landmarks, std::vector<double>& weights) const;

 private:
  Eigen::MatrixXd shapes_, gram_;
  std::vector<char> enabled_;
  double l1_, temporal_;
};

}  // namespace freetalk::rig
