#include <gtest/gtest.h>

#include <cmath>

#include "batches.h"
#include "freetalk/metrics/statistics.h"

namespace freetalk::metrics {
namespace {

at::Tensor values(const std::vector<double>& numbers) {
  return torch::tensor(numbers, torch::kDouble);
}

TEST(Bootstrap, OfTwoValuesHasThreeMeans) {
  // Means 0, 1, 2 with probability 1/4, 1/2, 1/4: the 10 % and 90 % quantiles are 0 and 2.
  BootstrapOptions options;
  options.method = "percentile";
  options.confidence = 0.8;
  const auto interval = bootstrap_mean(values({0, 2}), {}, options, core::make_generator(1));
  EXPECT_EQ(interval.mean, 1);
  EXPECT_EQ(interval.low, 0);
  EXPECT_EQ(interval.high, 2);
}

TEST(Bootstrap, CoversTheTrueMeanAsOftenAsItSays) {
  for (const auto* method : {"percentile", "bca"}) {
    BootstrapOptions options;
    options.method = method;
    options.num_resamples = 400;
    options.confidence = 0.9;
    auto generator = core::make_generator(2);
    int covered = 0;
    const int trials = 400;
    for (int trial = 0; trial < trials; ++trial) {
      const at::Tensor drawn = torch::randn({30}, generator, torch::dtype(torch::kDouble));
      const auto interval = bootstrap_mean(drawn, {}, options, generator);
      covered += interval.low <= 0 && 0 <= interval.high;
    }
    // 0.9 of 400 with a standard error of 0.015; the bootstrap of 30 values is 0.02 too narrow.
    EXPECT_NEAR(static_cast<double>(covered) / trials, 0.885, 0.045) << method;
  }
}

TEST(Bootstrap, WeightsLikeRepeatedFrames) {
  const auto interval =
      bootstrap_mean(values({1, 4}), values({30, 10}), {}, core::make_generator(3));
  EXPECT_DOUBLE_EQ(interval.mean, 1.75);
}

TEST(Bootstrap, OfOneSequenceHasNoInterval) {
  const auto one = bootstrap_mean(values({3}), {}, {}, core::make_generator(4));
  EXPECT_EQ(one.mean, 3);
  EXPECT_TRUE(std::isnan(one.low) && std::isnan(one.high));
  const auto equal = bootstrap_mean(values({3, 3, 3}), {}, {}, core::make_generator(4));
  EXPECT_EQ(equal.low, 3);
  EXPECT_EQ(equal.high, 3);
}

TEST(PermutationTest, EnumeratesFewPairs) {
  // Of 8 sign patterns of (1, 2, 3) two reach |6|.
  const auto test =
      permutation_test(values({1, 2, 3}), values({0, 0, 0}), {}, 1000, core::make_generator(5));
  EXPECT_DOUBLE_EQ(test.p_value, 2.0 / 8);
  EXPECT_DOUBLE_EQ(test.statistic, 2);
  // Weights decide what outweighs what: |3 - 1 - 2| is 0, |1 + 2 + 9| is reached twice, too.
  const auto weighted = permutation_test(values({1, 2, 3}), values({0, 0, 0}), values({1, 1, 3}),
                                         1000, core::make_generator(5));
  EXPECT_DOUBLE_EQ(weighted.statistic, 12.0 / 5);
}

TEST(PermutationTest, DrawsManyPairs) {
  auto generator = core::make_generator(6);
  const at::Tensor a = torch::randn({40}, generator, torch::dtype(torch::kDouble));
  const auto same = permutation_test(a, a, {}, 500, generator);
  EXPECT_EQ(same.p_value, 1);
  const auto apart = permutation_test(a + 5, a, {}, 500, generator);
  EXPECT_DOUBLE_EQ(apart.p_value, 1.0 / 501);
}

TEST(Wilcoxon, IsExactForFewPairs) {
  // All five differences positive: 2 of 32 sign patterns.
  const auto test = wilcoxon_test(values({1, 2, 3, 4, 5}), values({0, 0, 0, 0, 0}));
  EXPECT_EQ(test.statistic, 0);
  EXPECT_DOUBLE_EQ(test.p_value, 2.0 / 32);
  // Ties of size 1 (rank 1.5 each) against rank 3: sums 0 .. 6; |W - 3| >= 3 - 1.5 in 4 of 8.
  const auto tied = wilcoxon_test(values({1, -1, 2}), values({0, 0, 0}));
  EXPECT_DOUBLE_EQ(tied.statistic, 1.5);
  EXPECT_DOUBLE_EQ(tied.p_value, 2 * 3.0 / 8);
  EXPECT_EQ(wilcoxon_test(values({1, 2}), values({1, 2})).p_value, 1);
}

TEST(Wilcoxon, ApproximatesManyPairs) {
  auto generator = core::make_generator(7);
  const at::Tensor a = torch::randn({200}, generator, torch::dtype(torch::kDouble)) + 0.15;
  const at::Tensor zero = torch::zeros_like(a);
  const double exact = wilcoxon_test(a, zero).p_value;
  // One pair more of the smallest size changes little but the method.
  const at::Tensor more = torch::cat({a, values({1e-9})});
  const double approximate = wilcoxon_test(more, torch::zeros_like(more)).p_value;
  EXPECT_NEAR(approximate, exact, 0.02 * exact + 1e-3);
}

TEST(Holm, IsStepDown) {
  EXPECT_EQ(holm({0.01, 0.04, 0.03}), (std::vector<double>{0.03, 0.06, 0.06}));
  EXPECT_EQ(holm({0.9, 0.8}), (std::vector<double>{1.0, 1.0}));
  EXPECT_THROW(holm({1.5}), std::invalid_argument);
}

TEST(Statistics, RefuseWhatIsNotPaired) {
  EXPECT_THROW(wilcoxon_test(values({1, 2}), values({1})), std::invalid_argument);
  EXPECT_THROW(permutation_test(values({1, 2}), values({1}), {}, 9, core::make_generator(1)),
               std::invalid_argument);
  EXPECT_THROW(bootstrap_mean(values({1, NAN}), {}, {}, core::make_generator(1)),
               std::invalid_argument);
  EXPECT_THROW(bootstrap_mean(values({1, 2}), values({1, 0}), {}, core::make_generator(1)),
               std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::metrics
