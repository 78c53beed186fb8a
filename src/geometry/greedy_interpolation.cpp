#include "greedy_interpolation.h"

#include <algorithm>
#include <cmath>

namespace freetalk::geometry {
namespace {

constexpr double kExplained = 1e-9;  // share of the prior variance that is rounding

}  // namespace

double PoseKernel::operator()(double square_distance, double product) const {
  const double r = std::sqrt(3.0 * std::max(square_distance, 0.0)) / length;
  return offset + slope * product / (spread * spread) + (1.0 + r) * std::exp(-r);
}

GreedyInterpolation::GreedyInterpolation(Points points, const PoseKernel& kernel)
    : points_(std::move(points)), kernel_(kernel), squares_(points_.rows()) {
  for (Eigen::Index t = 0; t < points_.rows(); ++t) squares_[t] = points_.row(t).squaredNorm();
  variance_.resize(points_.rows());
  for (Eigen::Index t = 0; t < points_.rows(); ++t) variance_[t] = kernel_(0.0, squares_[t]);
  prior_ = variance_;
}

int64_t GreedyInterpolation::most_doubtful() const {
  Eigen::Index best = 0;
  variance_.maxCoeff(&best);
  return best;
}

bool GreedyInterpolation::add(int64_t point) {
  if (variance_[point] <= kExplained * prior_[point]) return false;
  const double pivot = std::sqrt(variance_[point]);
  Eigen::VectorXd value(points_.rows());
  for (Eigen::Index t = 0; t < points_.rows(); ++t) {
    const double square = (points_.row(t) - points_.row(point)).squaredNorm();
    const double product = (squares_[t] + squares_[point] - square) / 2;
    value[t] = kernel_(square, product);
  }
  for (const Eigen::VectorXd& before : basis_) value -= before[point] * before;
  value /= pivot;
  for (const int64_t node : nodes_) value[node] = 0.0;
  value[point] = pivot;
  variance_ = (variance_ - value.cwiseAbs2()).cwiseMax(0.0);
  variance_[point] = 0.0;
  nodes_.push_back(point);
  basis_.push_back(std::move(value));
  return true;
}

Eigen::MatrixXd GreedyInterpolation::factor(int64_t num_nodes) const {
  Eigen::MatrixXd lower = Eigen::MatrixXd::Zero(num_nodes, num_nodes);
  for (int64_t m = 0; m < num_nodes; ++m) {
    for (int64_t n = m; n < num_nodes; ++n) {
      lower(n, m) = basis_[static_cast<size_t>(m)][nodes_[static_cast<size_t>(n)]];
    }
  }
  return lower;
}

GreedyInterpolation::Points GreedyInterpolation::weights(int64_t num_nodes) const {
  std::vector<int64_t> all(static_cast<size_t>(points_.rows()));
  for (size_t t = 0; t < all.size(); ++t) all[t] = static_cast<int64_t>(t);
  return weights(all, num_nodes);
}

GreedyInterpolation::Points GreedyInterpolation::weights(const std::vector<int64_t>& points,
                                                         int64_t num_nodes) const {
  const Eigen::MatrixXd lower = factor(num_nodes);
  Points result(points.size(), num_nodes);
  Eigen::VectorXd row(num_nodes);
  for (size_t t = 0; t < points.size(); ++t) {
    for (int64_t m = 0; m < num_nodes; ++m) row[m] = basis_[static_cast<size_t>(m)][points[t]];
    lower.triangularView<Eigen::Lower>().transpose().solveInPlace(row);
    result.row(static_cast<Eigen::Index>(t)) = row;
  }
  return result;
}

Eigen::MatrixXd GreedyInterpolation::coefficients(const Eigen::MatrixXd& values) const {
  const Eigen::MatrixXd lower = factor(static_cast<int64_t>(nodes_.size()));
  Eigen::MatrixXd result = lower.triangularView<Eigen::Lower>().solve(values);
  lower.triangularView<Eigen::Lower>().transpose().solveInPlace(result);
  return result;
}

GreedyInterpolation::Points GreedyInterpolation::evaluate(
    const Points& elsewhere, const Eigen::MatrixXd& coefficients) const {
  Points result(elsewhere.rows(), coefficients.cols());
  Eigen::VectorXd covariance(nodes_.size());
  for (Eigen::Index t = 0; t < elsewhere.rows(); ++t) {
    for (size_t n = 0; n < nodes_.size(); ++n) {
      const auto node = points_.row(nodes_[n]);
      covariance[static_cast<Eigen::Index>(n)] =
          kernel_((elsewhere.row(t) - node).squaredNorm(), elsewhere.row(t).dot(node));
    }
    result.row(t) = covariance.transpose() * coefficients;
  }
  return result;
}

}  // namespace freetalk::geometry
