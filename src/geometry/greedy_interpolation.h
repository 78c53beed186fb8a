// Interpolation of a function of many variables from its values at few, well-chosen points.
//
// The function counts as a sample of a Gaussian process with covariance
//   k(x, y) = b + a x.y / s^2 + (1 + sqrt(3) r / l) exp(-sqrt(3) r / l),   r = |x - y|,
// that is, an affine part of free slope and a rest whose first term that is not smooth is r^3, as
// that of cubic radial basis functions. Its mean given the values at the nodes interpolates them;
// its variance says where that is doubtful. Nodes are chosen one by one where the variance is
// largest, which is a pivoted Cholesky factorisation (Newton's basis: Mueller & Schaback 2009).
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <vector>

namespace freetalk::geometry {

struct PoseKernel {
  double length = 1.0;    // l, unit of the points
  double spread = 1.0;    // s, unit of the points
  double slope = 100.0;   // a
  double offset = 100.0;  // b
  double operator()(double square_distance, double product) const;
};

class GreedyInterpolation {
 public:
  using Points = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

  /// @param points (T, D).
  GreedyInterpolation(Points points, const PoseKernel& kernel);

  int64_t num_points() const { return points_.rows(); }
  const std::vector<int64_t>& nodes() const { return nodes_; }
  /// (T,) k(x, x) less what the nodes explain, in the order of the points.
  const Eigen::VectorXd& variance() const { return variance_; }
  /// The first point of largest variance.
  int64_t most_doubtful() const;
  /// Makes a point a node. A point that the nodes explain already (to rounding) is left out.
  /// @returns whether it was added.
  bool add(int64_t point);

  /// (T, n): the value at each point as a sum over the first n nodes' values.
  Points weights(int64_t num_nodes) const;
  /// The same at the points given.
  Points weights(const std::vector<int64_t>& points, int64_t num_nodes) const;
  /// What evaluate() needs of values at all nodes, (n, M). @returns (n, M).
  Eigen::MatrixXd coefficients(const Eigen::MatrixXd& values) const;
  /// The interpolant at points that need not be among those of the constructor, (S, D).
  /// @returns (S, M).
  Points evaluate(const Points& elsewhere, const Eigen::MatrixXd& coefficients) const;

 private:
  /// (n, n) values of the first n basis functions at the first n nodes.
  Eigen::MatrixXd factor(int64_t num_nodes) const;

  Points points_;
  PoseKernel kernel_;
  Eigen::VectorXd squares_, variance_, prior_;
  std::vector<int64_t> nodes_;
  std::vector<Eigen::VectorXd> basis_;  // (T,) each
};

}  // namespace freetalk::geometry
