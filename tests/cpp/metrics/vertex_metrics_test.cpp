#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>

#include "batches.h"
#include "freetalk/metrics/dynamics.h"
#include "freetalk/metrics/registry.h"
#include "freetalk/metrics/vertex_error.h"

namespace freetalk::metrics {
namespace {

constexpr double kRounding = 1e-12;  // sums of a few hundred doubles of size 1e-2

TEST(VertexError, OfAnOffsetIsItsLength) {
  const at::Tensor target = random_motion(1, 2, 5, 4);
  const at::Tensor pred = target + torch::tensor({0.003, 0.0, 0.004}, torch::kDouble);
  for (const auto* name : {"lve_l2", "mve_mean", "mve_max"}) {
    EXPECT_TRUE(torch::allclose(vertex_metric(name, pred, target, 30),
                                torch::full({2}, 0.005, torch::kDouble), 0, kRounding))
        << name;
  }
  EXPECT_TRUE(
      torch::allclose(lve(pred, target), torch::full({2}, 25e-6, torch::kDouble), 0, kRounding));
}

TEST(VertexError, TakesTheWorstVertexOfEachFrame) {
  const at::Tensor target = torch::zeros({1, 2, 3, 3}, torch::kDouble);
  at::Tensor pred = target.clone();
  pred[0][0][1][0] = 0.002;  // frame 0: vertex 1
  pred[0][1][2][1] = 0.004;  // frame 1: vertex 2
  EXPECT_NEAR(lve(pred, target).item<double>(), (4e-6 + 16e-6) / 2, kRounding);
  EXPECT_NEAR(mve_max(pred, target).item<double>(), 0.003, kRounding);
  EXPECT_NEAR(mve_mean(pred, target).item<double>(), 0.006 / 6, kRounding);
  // The mask without vertex 2 sees the first frame's error alone.
  const Selection two = {torch::tensor({0, 1}), {}, {}};
  EXPECT_NEAR(lve(pred, target, two).item<double>(), 2e-6, kRounding);
  const Selection same = {torch::tensor({true, true, false}), {}, {}};
  EXPECT_EQ(lve(pred, target, same).item<double>(), lve(pred, target, two).item<double>());
}

TEST(VertexMetrics, IgnoreWhatIsNotValid) {
  const at::Tensor pred = random_motion(2, 1, 9, 6), target = random_motion(3, 1, 9, 6);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto padded = [nan](const at::Tensor& motion, double filler) {
    return torch::cat({motion, torch::full({1, 4, 6, 3}, filler, torch::kDouble)}, 1);
  };
  const at::Tensor valid = torch::arange(13).lt(9).unsqueeze(0);
  for (const auto& info : vertex_metrics()) {
    const auto plain = vertex_metric(info.name, pred, target, 30);
    const auto masked =
        vertex_metric(info.name, padded(pred, nan), padded(target, 7.0), 30, {{}, valid, {}});
    EXPECT_TRUE(torch::allclose(plain, masked, 1e-12, 0)) << info.name;
  }
}

TEST(VertexMetrics, OfABatchAreThoseOfItsSequences) {
  const at::Tensor pred = random_motion(4, 3, 7, 5), target = random_motion(5, 3, 7, 5);
  for (const auto& info : vertex_metrics()) {
    const at::Tensor all = vertex_metric(info.name, pred, target, 30);
    ASSERT_EQ(all.sizes(), at::IntArrayRef({3})) << info.name;
    for (int64_t b = 0; b < 3; ++b) {
      const at::Tensor own =
          vertex_metric(info.name, pred.narrow(0, b, 1), target.narrow(0, b, 1), 30);
      EXPECT_NEAR(all[b].item<double>(), own.item<double>(), 1e-12 * own.abs().item<double>())
          << info.name;
    }
  }
}

TEST(VertexMetrics, OfAPerfectPredictionAreIdeal) {
  const at::Tensor motion = random_motion(6, 2, 8, 5);
  for (const auto& info : vertex_metrics()) {
    if (info.name == "jerk_energy") continue;  // that of the motion itself
    const at::Tensor value = vertex_metric(info.name, motion, motion, 30);
    EXPECT_LT((value - info.ideal).abs().max().item<double>(), kRounding) << info.name;
  }
}

TEST(Fdd, IsTheDifferenceOfSpreads) {
  // |m|^2 alternates between 0 and a^2: its standard deviation is a^2 / 2.
  const auto swinging = [](double amplitude) {
    at::Tensor motion = torch::zeros({1, 6, 2, 3}, torch::kDouble);
    for (int64_t t = 1; t < 6; t += 2) motion[0][t].select(1, 1).fill_(amplitude);
    return motion;
  };
  const at::Tensor small = swinging(0.002), large = swinging(0.006);
  EXPECT_NEAR(fdd(small, large).item<double>(), (36e-6 - 4e-6) / 2, kRounding);
  EXPECT_NEAR(fdd(large, small).item<double>(), -(36e-6 - 4e-6) / 2, kRounding);
  EXPECT_NEAR(fdd_abs(large, small).item<double>(), (36e-6 - 4e-6) / 2, kRounding);
}

TEST(Delta, OfConstantVelocitiesIsThatOfTheVectors) {
  const at::Tensor time = torch::arange(5, torch::kDouble).view({1, 5, 1, 1});
  const at::Tensor x = torch::tensor({0.001, 0.0, 0.0}, torch::kDouble).view({1, 1, 1, 3});
  const at::Tensor y = torch::tensor({0.0, 0.002, 0.0}, torch::kDouble).view({1, 1, 1, 3});
  const at::Tensor right = time * x, up = time * y, left = time * -x;
  EXPECT_NEAR(delta_m(right, up).item<double>(), 5e-6, kRounding);
  EXPECT_NEAR(delta_m_l2(right, up).item<double>(), std::sqrt(5e-6), kRounding);
  EXPECT_NEAR(delta_cd(right, up).item<double>(), 1, kRounding);
  EXPECT_NEAR(delta_cd(right, 3 * right).item<double>(), 0, kRounding);
  EXPECT_NEAR(delta_cd(right, left).item<double>(), 2, kRounding);
  EXPECT_NEAR(delta_cd(right, 0 * right).item<double>(), 1, kRounding);
  EXPECT_EQ(delta_cd(0 * right, 0 * right).item<double>(), 0);  // still, and predicted still
}

TEST(DeltaCdWeighted, CountsMovementAlone) {
  const at::Tensor time = torch::arange(4, torch::kDouble).view({1, 4, 1});
  at::Tensor target = torch::zeros({1, 4, 2, 3}, torch::kDouble), pred = target.clone();
  target.select(2, 0).select(2, 0).copy_(time.squeeze(2));  // vertex 0 moves along x
  pred.select(2, 0).select(2, 0).copy_(time.squeeze(2));
  pred.select(2, 1).select(2, 2).copy_(time.squeeze(2));  // vertex 1 should stand still
  EXPECT_NEAR(delta_cd(pred, target).item<double>(), 0.5, kRounding);
  EXPECT_NEAR(delta_cd_weighted(pred, target).item<double>(), 0, kRounding);
  EXPECT_EQ(delta_cd_weighted(pred, torch::zeros_like(target)).item<double>(), 0);
}

TEST(JerkEnergy, OfACubicIsThatOfItsThirdDerivative) {
  // x = a t^3 / 6 in seconds has jerk a everywhere; the third difference of a cubic is exact.
  const double fps = 25, a = 0.3;
  const at::Tensor seconds = torch::arange(9, torch::kDouble) / fps;
  at::Tensor motion = torch::zeros({1, 9, 2, 3}, torch::kDouble);
  for (int64_t v = 0; v < 2; ++v) motion[0].select(1, v).select(1, 1).copy_(a / 6 * seconds.pow(3));
  // The third difference loses nine digits to cancellation.
  EXPECT_NEAR(jerk_energy(motion, fps).item<double>(), a * a, 1e-6);
  EXPECT_NEAR(jitter_ratio(2 * motion, motion).item<double>(), 4, 1e-6);
}

TEST(JitterRatio, OfStillFacesIsOne) {
  const at::Tensor still = torch::zeros({1, 5, 2, 3}, torch::kDouble);
  EXPECT_EQ(jitter_ratio(still, still).item<double>(), 1);
  EXPECT_TRUE(std::isinf(jitter_ratio(random_motion(7, 1, 5, 2), still).item<double>()));
}

TEST(VertexMetrics, CountOnlyRunsOfValidFrames) {
  at::Tensor pred = random_motion(8, 1, 6, 3), target = random_motion(9, 1, 6, 3);
  const at::Tensor valid = torch::tensor({{true, true, false, true, true, true}});
  const auto part = [](const at::Tensor& x, int64_t start, int64_t count) {
    return x.narrow(1, start, count);
  };
  const double first = delta_m(part(pred, 0, 2), part(target, 0, 2)).item<double>();
  const double second = delta_m(part(pred, 3, 3), part(target, 3, 3)).item<double>();
  EXPECT_NEAR(delta_m(pred, target, {{}, valid, {}}).item<double>(), (first + 2 * second) / 3,
              kRounding);
}

TEST(VertexMetrics, TakeSinglePrecision) {
  const at::Tensor pred = random_motion(10, 1, 6, 3).to(torch::kFloat);
  const at::Tensor target = random_motion(11, 1, 6, 3).to(torch::kFloat);
  for (const auto& info : vertex_metrics()) {
    const at::Tensor value = vertex_metric(info.name, pred, target, 30);
    EXPECT_EQ(value.scalar_type(), torch::kDouble) << info.name;
    EXPECT_TRUE(torch::equal(
        value, vertex_metric(info.name, pred.to(torch::kDouble), target.to(torch::kDouble), 30)))
        << info.name;
  }
}

void expect_error(const std::function<void()>& call, const std::string& words) {
  try {
    call();
    ADD_FAILURE() << "nothing was thrown, expected: " << words;
  } catch (const std::invalid_argument& error) {
    EXPECT_NE(std::string(error.what()).find(words), std::string::npos) << error.what();
  }
}

TEST(VertexMetrics, SayWhatIsWrong) {
  const at::Tensor motion = random_motion(12, 2, 3, 4);
  const at::Tensor longer = random_motion(13, 2, 5, 4);
  expect_error([&] { lve(motion[0], motion); }, "expected pred (B, T, V, 3)");
  expect_error([&] { lve(motion, longer); }, "differ in shape");
  expect_error([&] { lve(motion, motion, {torch::tensor({4}), {}, {}}); }, "names vertex 4");
  expect_error([&] { lve(motion, motion, {torch::tensor({true}), {}, {}}); }, "for 1 vertices");
  expect_error(
      [&] {
        lve(motion, motion, {torch::zeros({4}, torch::kBool), {}, {}});
      },
      "holds no vertex");
  expect_error([&] { lve(motion, motion, {{}, torch::ones({2, 3}), {}}); }, "bool");
  const at::Tensor valid = torch::tensor({{true, true, true}, {true, false, true}});
  expect_error([&] { delta_m(motion, motion, {{}, valid, {}}); }, "sequence 1 of the batch");
  expect_error([&] { jerk_energy(motion, 30); }, "needs 4 frames, found 3");
  expect_error([&] { jerk_energy(longer, 0); }, "fps");
  expect_error([&] { metric_info("mve"); }, "did you mean 'lve'");
}

}  // namespace
}  // namespace freetalk::metrics
