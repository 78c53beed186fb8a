#include "shape_solver.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace freetalk::rig {
namespace {

constexpr int kSweeps = 200;       // at most
constexpr double kSettled = 1e-6;  // largest change of a weight in the last sweep

int index_of(const std::vector<std::string>& names, const std::string& name) {
  const auto found = std::find(names.begin(), names.end(), name);
  return found == names.end() ? -1 : static_cast<int>(found - names.begin());
}

/// The twin on the other side: "jawLeft" has one that undoes it, "mouthSmileLeft" one to go with.
std::string other_side(const std::string& name) {
  for (const auto& [side, other] : {std::pair{"Left", "Right"}, std::pair{"Right", "Left"}}) {
    const size_t length = std::string(side).size();
    if (name.size() > length && name.compare(name.size() - length, length, side) == 0) {
      return name.substr(0, name.size() - length) + other;
    }
  }
  return {};
}

bool moves_sideways(const std::string& name) {
  return name == "jawLeft" || name == "jawRight" || name == "mouthLeft" || name == "mouthRight";
}

/// Shapes of one side that undo each other.
const std::vector<std::pair<std::string, std::string>>& opposites() {
  static const std::vector<std::pair<std::string, std::string>> pairs = {
      {"eyeBlink", "eyeWide"},          {"eyeSquint", "eyeWide"},
      {"browDown", "browOuterUp"},      {"mouthSmile", "mouthFrown"},
      {"mouthPress", "mouthLowerDown"}, {"mouthPress", "mouthUpperUp"}};
  return pairs;
}

}  // namespace

ShapeSolver::ShapeSolver(const Eigen::MatrixXd& shapes, const std::vector<std::string>& names,
                         const RigOptions& options)
    : shapes_(shapes),
      gram_(shapes.transpose() * shapes),
      enabled_(names.size(), 1),
      l1_(options.l1),
      temporal_(options.temporal) {
  gram_.diagonal().array() += options.l2 + options.temporal;
  const auto cancel = [&](const std::string& a, const std::string& b) {
    const int i = index_of(names, a), j = index_of(names, b);
    if (i < 0 || j < 0) return;
    gram_(i, j) += options.cancel / 2;
    gram_(j, i) += options.cancel / 2;
  };
  for (size_t i = 0; i < names.size(); ++i) {
    const std::string twin = other_side(names[i]);
    const int j = index_of(names, twin);
    if (j <= static_cast<int>(i)) continue;
    if (moves_sideways(names[i])) {
      cancel(names[i], twin);
      continue;
    }
    const auto row = static_cast<Eigen::Index>(i);
    gram_(row, row) += options.symmetry;
    gram_(j, j) += options.symmetry;
    gram_(row, j) -= options.symmetry;
    gram_(j, row) -= options.symmetry;
  }
  for (const auto& [a, b] : opposites()) {
    for (const char* side : {"Left", "Right"}) cancel(a + side, b + side);
  }
  for (const std::string& name : options.disabled) {
    const int i = index_of(names, name);
    if (i >= 0) enabled_[static_cast<size_t>(i)] = 0;
  }
}

void ShapeSolver::solve(const Eigen::VectorXd& landmarks, std::vector<double>& weights) const {
  const auto count = static_cast<Eigen::Index>(enabled_.size());
  weights.resize(enabled_.size(), 0.0);
  Eigen::Map<Eigen::VectorXd> w(weights.data(), count);
  const Eigen::VectorXd target =
      ((shapes_.transpose() * landmarks + temporal_ * w).array() - l1_ / 2).matrix();
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    double change = 0.0;
    for (Eigen::Index i = 0; i < count; ++i) {
      if (enabled_[static_cast<size_t>(i)] == 0 || gram_(i, i) <= 0.0) continue;
      const double rest = gram_.col(i).dot(w) - gram_(i, i) * w[i];
      const double value = std::clamp((target[i] - rest) / gram_(i, i), 0.0, 1.0);
      change = std::max(change, std::abs(value - w[i]));
      w[i] = value;
    }
    if (change < kSettled) break;
  }
}

}  // namespace freetalk::rig
