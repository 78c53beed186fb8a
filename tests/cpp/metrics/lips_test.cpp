#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "batches.h"
#include "freetalk/metrics/affect.h"
#include "freetalk/metrics/lips.h"
#include "freetalk/metrics/samples.h"

namespace freetalk::metrics {
namespace {

at::Tensor series(const std::vector<double>& values) {
  return torch::tensor(values, torch::kDouble);
}

TEST(LipOpening, IsTheMeanGapAlongTheAxis) {
  at::Tensor motion = torch::zeros({1, 2, 4, 3}, torch::kDouble);
  motion[0][1][0][1] = 0.004;   // upper of pair 0
  motion[0][1][2][1] = -0.002;  // lower of pair 0
  motion[0][1][3][0] = 0.5;     // sideways: not an opening
  const at::Tensor opening =
      lip_opening(motion, torch::tensor({0, 1}), torch::tensor({2, 3}), series({0, 1, 0}));
  EXPECT_NEAR(opening[0][0].item<double>(), 0, 1e-15);
  EXPECT_NEAR(opening[0][1].item<double>(), 0.006 / 2, 1e-15);
}

TEST(LipClosures, LookAtTheBilabialAlone) {
  const at::Tensor opening = series({0.010, 0.001, 0.010, 0.002, 0.010, 0.010});
  const std::vector<Phone> phones = {
      {1, 2, "P"}, {2, 3, "AA"}, {3, 4, "M"}, {4, 5, "B"}, {6, 7, "P"}};  // the last is beyond
  EXPECT_EQ(lip_closures(opening, phones, 1), (std::vector<bool>{true, false, false}));
  ClosureOptions options;
  options.share = 0.25;
  EXPECT_EQ(lip_closures(opening, phones, 1, options), (std::vector<bool>{true, true, false}));
  options.largest = 0.002;  // a face that hardly opens is judged by another's opening
  EXPECT_EQ(lip_closures(opening, phones, 1, options), (std::vector<bool>{false, false, false}));
  options.share = 1;
  EXPECT_THROW(lip_closures(opening, phones, 1, options), std::invalid_argument);
}

TEST(Correlation, IsPearsons) {
  const at::Tensor a = series({1, 2, 3, 4}).unsqueeze(0);
  const at::Tensor b = series({2, 1, 4, 3}).unsqueeze(0);
  EXPECT_NEAR(correlation(a, 3 * a + 1).item<double>(), 1, 1e-15);
  EXPECT_NEAR(correlation(a, -a).item<double>(), -1, 1e-15);
  EXPECT_NEAR(correlation(a, b).item<double>(), 0.6, 1e-15);
  EXPECT_EQ(correlation(a, torch::ones_like(a)).item<double>(), 0);
  const at::Tensor valid = torch::tensor({{true, true, false, false}});
  EXPECT_NEAR(correlation(a, b, valid).item<double>(), -1, 1e-15);
}

TEST(BestOffset, FindsADelayBetweenFrames) {
  const double fps = 30, delay_s = 0.08;  // 2.4 frames
  const at::Tensor seconds = torch::arange(120, torch::kDouble) / fps;
  const auto wave = [](const at::Tensor& t) { return (11 * t).sin() + 0.5 * (23 * t + 1).sin(); };
  const auto late = best_offset(wave(seconds - delay_s), wave(seconds), fps);
  // The parabola through samples of a sine is out by a few percent of a frame.
  EXPECT_NEAR(late.offset_ms, 80, 0.1 * 1000 / fps);
  EXPECT_GT(late.correlation, 0.97);
  const auto early = best_offset(wave(seconds), wave(seconds - delay_s), fps);
  EXPECT_NEAR(early.offset_ms, -80, 0.1 * 1000 / fps);
  EXPECT_EQ(best_offset(torch::ones(60), wave(seconds.narrow(0, 0, 60)), fps).offset_ms, 0);
  EXPECT_THROW(best_offset(torch::ones(8), torch::ones(8), fps), std::invalid_argument);
}

TEST(LogEnergy, FollowsTheLoudness) {
  const at::Tensor wave = torch::cat({torch::full({8000}, 0.01), torch::full({8000}, 0.1)});
  const at::Tensor energy = log_energy(wave, 30, 30, 16000);
  // Ten times the amplitude is log(100) in energy, but for the floor of 1e-6 of the loudest frame.
  EXPECT_NEAR((energy[25] - energy[5]).item<double>(), std::log(100), 1e-3);
}

TEST(AffectFeatures, AreMeanAndSpread) {
  const at::Tensor motion = torch::tensor({1.0, 3.0}, torch::kDouble).view({1, 2, 1, 1}) *
                            torch::ones({1, 1, 2, 3}, torch::kDouble);
  const at::Tensor features = affect_features(motion, {torch::tensor({1}), {}, {}});
  EXPECT_TRUE(torch::equal(features, torch::tensor({{2., 2., 2., 1., 1., 1.}}, torch::kDouble)));
}

TEST(NearestCentroid, FindsSeparateClasses) {
  const at::Tensor noise =
      0.1 * torch::randn({40, 4}, core::make_generator(1), torch::dtype(torch::kDouble));
  const at::Tensor centres = torch::arange(40).ge(20).to(torch::kDouble).unsqueeze(1);
  std::vector<std::string> labels(20, "b");
  labels.resize(40, "a");  // class "a" lies around 1, class "b" around 0
  const NearestCentroid classifier(noise + centres, labels, 0.05);
  EXPECT_EQ(classifier.classes(), (std::vector<std::string>{"a", "b"}));
  EXPECT_EQ(
      classifier.predict(torch::tensor({0.1, 0.9}, torch::kDouble).view({2, 1}).repeat({1, 4})),
      (std::vector<std::string>{"b", "a"}));
  const auto hits = recognised(noise + centres, noise + centres, labels, 0.05);
  EXPECT_EQ(std::count(hits.begin(), hits.end(), true), 40);
}

TEST(Recognised, LeavesTheSequenceItselfOut) {
  // Centroids of all four are 1.5 and 2.5, which would recognise 0 and 4. Without 0 they are 3
  // and 2.5, without 4 they are 1.5 and 1: neither is.
  const at::Tensor features = torch::tensor({{0.0}, {3.0}, {1.0}, {4.0}}, torch::kDouble);
  const std::vector<std::string> labels = {"a", "a", "b", "b"};
  EXPECT_EQ(recognised(features, features, labels, 1.0), (std::vector<bool>(4, false)));
  const NearestCentroid all(features, labels, 1.0);
  EXPECT_EQ(all.predict(features), (std::vector<std::string>{"a", "b", "a", "b"}));
  EXPECT_THROW(recognised(features, features, {"a", "a", "b", "c"}, 1.0), std::invalid_argument);
}

TEST(Diversity, IsEquationTwenty) {
  const at::Tensor codes = torch::tensor({0.0, 3.0, 6.0}, torch::kDouble).view({1, 3, 1, 1}) *
                           torch::ones({1, 1, 1, 4}, torch::kDouble);
  // Pairs are 6, 6 and 12 apart, each counted twice, over K = 3.
  EXPECT_NEAR(diversity(codes).item<double>(), 2.0 * (6 + 6 + 12) / 3, 1e-12);
  EXPECT_THROW(diversity(codes.narrow(1, 0, 1)), std::invalid_argument);
}

TEST(DiversityVertex, IsTheMeanDistanceOfPairs) {
  const at::Tensor samples = torch::tensor({0.0, 1.0, 3.0}, torch::kDouble).view({1, 3, 1, 1, 1}) *
                             torch::tensor({1.0, 0.0, 0.0}, torch::kDouble) *
                             torch::ones({1, 3, 4, 2, 1}, torch::kDouble);
  EXPECT_NEAR(diversity_vertex(samples).item<double>(), (1 + 2 + 3) / 3.0, 1e-12);
}

TEST(SampleErrors, AreThoseOfTheMeanAndOfTheBest) {
  const at::Tensor target = random_motion(2, 1, 4, 3);
  const at::Tensor x = torch::tensor({1.0, 0.0, 0.0}, torch::kDouble);
  const at::Tensor samples = torch::stack({target + 0.001 * x, target - 0.003 * x}, 1);
  EXPECT_NEAR(lve_mean_estimate(samples, target).item<double>(), 1e-6, 1e-15);
  EXPECT_NEAR(lve_coverage(samples, target).item<double>(), 1e-6, 1e-15);
  EXPECT_NEAR(lve_coverage(samples.narrow(1, 1, 1), target).item<double>(), 9e-6, 1e-15);
}

}  // namespace
}  // namespace freetalk::metrics
