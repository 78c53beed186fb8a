#include "freetalk/geometry/low_pass.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "square.h"

namespace freetalk::geometry {
namespace {

constexpr double kPi = 3.14159265358979323846;

SurfaceLowPass low_pass_of(const Square& square, double length) {
  return {square.vertices, square.faces, Eigen::VectorXd::Constant(441, length)};
}

/// (1, 441, 1) of a function of x and y.
template <class Function>
at::Tensor field_of(const Square& square, const Function& function) {
  at::Tensor field = at::empty({1, 441, 1}, at::kDouble);
  for (int v = 0; v < 441; ++v) {
    field[0][v][0] = function(square.vertices(v, 0), square.vertices(v, 1));
  }
  return field;
}

TEST(SurfaceLowPass, KeepsOfAWaveWhatItsLengthSays) {
  const Square square(false);
  for (const double wave : {0.2, 0.1, 0.05}) {  // cosines whose slope is zero at the borders
    const at::Tensor field =
        field_of(square, [wave](double x, double) { return std::cos(2 * kPi * x / wave); });
    for (const double length : {0.004, 0.008, 0.016}) {
      const at::Tensor kept = low_pass_of(square, length).apply(field);
      const double share =
          (kept * field).sum().item<double>() / field.square().sum().item<double>();
      EXPECT_NEAR(share, 1 / (1 + std::pow(2 * kPi * length / wave, 4)), 0.04)
          << "wave " << wave << ", length " << length;
    }
  }
}

TEST(SurfaceLowPass, KeepsConstantsAndEverythingAtLengthZero) {
  const Square square(true);
  at::manual_seed(1);
  const at::Tensor noise = at::randn({2, 441, 3}, at::kDouble);
  EXPECT_TRUE(at::allclose(low_pass_of(square, 0.0).apply(noise), noise, 1e-9, 1e-12));
  const at::Tensor constant = at::full({1, 441, 3}, 0.7);
  EXPECT_TRUE(at::allclose(low_pass_of(square, 0.02).apply(constant), constant, 1e-6));
  EXPECT_EQ(low_pass_of(square, 0.02).apply(constant).scalar_type(), at::kFloat);
}

TEST(SurfaceLowPass, DoesNotCrossAGap) {
  const auto step = [](double, double y) { return y < 0.0525 ? 0.0 : 1.0; };  // at the slit
  const auto middle = [&](bool slit) {
    const Square square(slit);
    const at::Tensor kept = low_pass_of(square, 0.004).apply(field_of(square, step)).flatten();
    return kept[21 * 11 + 10].item<double>() - kept[21 * 10 + 10].item<double>();
  };
  EXPECT_LT(middle(false), 0.6);
  EXPECT_GT(middle(true), 0.95);
}

TEST(SurfaceLowPass, ItsGradientIsItsTranspose) {
  Square square(true);
  square.vertices.row(0) = square.vertices.row(1);  // a sliver
  const SurfaceLowPass low_pass = low_pass_of(square, 0.006);
  at::manual_seed(2);
  at::Tensor field = at::randn({1, 441, 1}, at::kDouble).requires_grad_(true);
  const at::Tensor other = at::randn({1, 441, 1}, at::kDouble);
  (low_pass.apply(field) * other).sum().backward();
  const at::Tensor probe = at::randn({1, 441, 1}, at::kDouble);
  const double forward = (low_pass.apply(probe) * other).sum().item<double>();
  EXPECT_NEAR((field.grad() * probe).sum().item<double>(), forward, 1e-9 * std::abs(forward));
}

TEST(SurfaceLowPass, RefusesWhatMakesNoSense) {
  const Square square(false);
  EXPECT_THROW(low_pass_of(square, -0.001), std::invalid_argument);
  EXPECT_THROW(low_pass_of(square, std::numeric_limits<double>::infinity()), std::invalid_argument);
  EXPECT_THROW(SurfaceLowPass(square.vertices, square.faces, Eigen::VectorXd::Zero(7)),
               std::invalid_argument);
  EXPECT_THROW(low_pass_of(square, 0.001).apply(at::zeros({1, 7, 3})), std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::geometry
