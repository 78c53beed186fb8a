#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <limits>

#include "batches.h"
#include "freetalk/metrics/trajectory.h"

namespace freetalk::metrics {
namespace {

using Cost = std::function<double(int64_t, int64_t)>;
using Join = std::function<double(double, double)>;

/// Least cost over every path, each walked to its end.
double brute_force(const Cost& cost, const Join& join, int64_t rows, int64_t columns) {
  double least = std::numeric_limits<double>::infinity();
  const std::function<void(int64_t, int64_t, double)> walk = [&](int64_t i, int64_t j,
                                                                 double before) {
    const double here = join(before, cost(i, j));
    if (i == rows - 1 && j == columns - 1) {
      least = std::min(least, here);
      return;
    }
    if (i + 1 < rows) walk(i + 1, j, here);
    if (j + 1 < columns) walk(i, j + 1, here);
    if (i + 1 < rows && j + 1 < columns) walk(i + 1, j + 1, here);
  };
  walk(0, 0, 0.0);
  return least;
}

double sum(double a, double b) { return a + b; }
double greatest(double a, double b) { return std::max(a, b); }

/// Distance of vertices `first` .. `last` - 1, averaged.
Cost distance(const at::Tensor& pred, const at::Tensor& target, int64_t first, int64_t last) {
  const at::Tensor all = (pred[0].unsqueeze(1) - target[0].unsqueeze(0))
                             .norm(2, -1)
                             .narrow(2, first, last - first)
                             .mean(2);  // (T, T')
  return [all](int64_t i, int64_t j) { return all[i][j].item<double>(); };
}

class Paths : public testing::TestWithParam<std::pair<int64_t, int64_t>> {};

TEST_P(Paths, AreTheBestOfAll) {
  const auto [rows, columns] = GetParam();
  const int64_t vertices = 3;
  const at::Tensor pred = random_motion(1, 1, rows, vertices);
  const at::Tensor target = random_motion(2, 1, columns, vertices);
  const Cost together = distance(pred, target, 0, vertices);
  const double warped = brute_force(together, sum, rows, columns);
  const double leash = brute_force(together, greatest, rows, columns);
  double warped_each = 0, leash_each = 0;
  for (int64_t v = 0; v < vertices; ++v) {
    const Cost own = distance(pred, target, v, v + 1);
    warped_each += brute_force(own, sum, rows, columns) / vertices;
    leash_each += brute_force(own, greatest, rows, columns) / vertices;
  }
  const double rounding = 1e-14;  // of sums of a dozen numbers near 0.01
  EXPECT_NEAR(dtw_sum(pred, target).item<double>(), warped, rounding);
  EXPECT_NEAR(dtw(pred, target).item<double>(), warped / columns, rounding);
  EXPECT_NEAR(dfd(pred, target).item<double>(), leash, rounding);
  EXPECT_NEAR(dtw_vertex(pred, target).item<double>(), warped_each / columns, rounding);
  EXPECT_NEAR(dfd_vertex(pred, target).item<double>(), leash_each, rounding);
}

INSTANTIATE_TEST_SUITE_P(Lengths, Paths,
                         testing::Values(std::pair{1, 1}, std::pair{1, 5}, std::pair{5, 1},
                                         std::pair{4, 6}, std::pair{6, 4}, std::pair{6, 6}));

TEST(Dtw, ForgivesAHeldFrame) {
  const at::Tensor target = random_motion(3, 1, 6, 4);
  const at::Tensor held = target.index_select(1, torch::tensor({0, 1, 1, 1, 2, 3, 4, 5}));
  EXPECT_EQ(dtw(held, target).item<double>(), 0);
  EXPECT_EQ(dfd(held, target).item<double>(), 0);
}

TEST(Trajectory, OfAnOffsetIsItsLengthForFrechet) {
  // Two copies of one point, d apart: every coupling costs d.
  const at::Tensor still = torch::zeros({1, 5, 2, 3}, torch::kDouble);
  const at::Tensor moved = still + torch::tensor({0.0, 0.003, 0.004}, torch::kDouble);
  EXPECT_NEAR(dfd(moved, still).item<double>(), 0.005, 1e-15);
  EXPECT_NEAR(dtw(moved, still).item<double>(), 0.005, 1e-15);
}

TEST(Trajectory, EachSideHasItsOwnValidFrames) {
  const at::Tensor pred = random_motion(4, 2, 6, 3), target = random_motion(5, 2, 8, 3);
  const at::Tensor valid = torch::arange(6).lt(torch::tensor({{6}, {4}}));
  const at::Tensor target_valid = torch::arange(8).lt(torch::tensor({{5}, {8}}));
  const at::Tensor both = dtw(pred, target, {{}, valid, target_valid});
  const at::Tensor second = dtw(pred.narrow(0, 1, 1).narrow(1, 0, 4), target.narrow(0, 1, 1));
  const at::Tensor first = dtw(pred.narrow(0, 0, 1), target.narrow(0, 0, 1).narrow(1, 0, 5));
  EXPECT_DOUBLE_EQ(both[0].item<double>(), first.item<double>());
  EXPECT_DOUBLE_EQ(both[1].item<double>(), second.item<double>());
}

TEST(Trajectory, RefusesOtherVertices) {
  EXPECT_THROW(dtw(random_motion(6, 1, 3, 2), random_motion(7, 1, 3, 4)), std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::metrics
