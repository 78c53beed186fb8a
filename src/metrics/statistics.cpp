#include "freetalk/metrics/statistics.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "freetalk/core/error.h"

namespace freetalk::metrics {
namespace {

constexpr int64_t kMaxDraws = int64_t{1} << 22;  // random numbers held at once
constexpr size_t kMaxExactPairs = 200;           // of Wilcoxon's test

std::vector<double> to_vector(const at::Tensor& values, const char* where, const char* name) {
  FREETALK_CHECK(values.defined() && values.dim() == 1 && values.numel() > 0, where, ": expected ",
                 name, " (N,) and not empty, found ",
                 values.defined() ? c10::str(values.sizes()) : "nothing");
  const at::Tensor held = values.to(at::kCPU, at::kDouble).contiguous();
  FREETALK_CHECK(held.isfinite().all().item<bool>(), where, ": ", name,
                 " holds a value that is not finite");
  return {held.data_ptr<double>(), held.data_ptr<double>() + held.numel()};
}

std::vector<double> checked_weights(const at::Tensor& weights, size_t count, const char* where) {
  if (!weights.defined()) return std::vector<double>(count, 1.0);
  auto result = to_vector(weights, where, "weights");
  FREETALK_CHECK(result.size() == count, where, ": ", count, " values but ", result.size(),
                 " weights");
  FREETALK_CHECK(*std::min_element(result.begin(), result.end()) > 0, where,
                 ": weights must be above 0");
  return result;
}

double weighted_mean(const std::vector<double>& values, const std::vector<double>& weights) {
  return std::inner_product(values.begin(), values.end(), weights.begin(), 0.0) /
         std::accumulate(weights.begin(), weights.end(), 0.0);
}

double normal_cdf(double z) { return 0.5 * std::erfc(-z / std::sqrt(2.0)); }

double normal_quantile(double p) {
  return at::special_ndtri(at::scalar_tensor(p, at::kDouble)).item<double>();
}

/// Linear between order statistics, as numpy.quantile.
double quantile(const std::vector<double>& sorted, double p) {
  const double position = p * static_cast<double>(sorted.size() - 1);
  const auto below = static_cast<size_t>(position);
  const size_t above = std::min(below + 1, sorted.size() - 1);
  return sorted[below] + (position - static_cast<double>(below)) * (sorted[above] - sorted[below]);
}

/// Weighted means of resampled sequences, sorted.
std::vector<double> resampled_means(const std::vector<double>& values,
                                    const std::vector<double>& weights, int64_t num_resamples,
                                    const at::Generator& generator) {
  const auto count = static_cast<int64_t>(values.size());
  const at::Tensor weight = at::tensor(weights, at::kDouble);
  const at::Tensor product = at::tensor(values, at::kDouble) * weight;
  std::vector<double> means;
  means.reserve(static_cast<size_t>(num_resamples));
  const int64_t rows = std::max<int64_t>(1, kMaxDraws / count);
  for (int64_t done = 0; done < num_resamples; done += rows) {
    const at::Tensor drawn = at::randint(0, count, {std::min(rows, num_resamples - done), count},
                                         generator, at::TensorOptions().dtype(at::kLong));
    const at::Tensor mean = (product.take(drawn).sum(1) / weight.take(drawn).sum(1)).contiguous();
    means.insert(means.end(), mean.data_ptr<double>(), mean.data_ptr<double>() + mean.numel());
  }
  std::sort(means.begin(), means.end());
  return means;
}

/// Acceleration of BCa: skewness of the leave-one-out means [Efron 1987, Eq. 6.6].
double acceleration(const std::vector<double>& values, const std::vector<double>& weights) {
  const double total = std::accumulate(weights.begin(), weights.end(), 0.0);
  const double sum = std::inner_product(values.begin(), values.end(), weights.begin(), 0.0);
  std::vector<double> left_out;
  for (size_t i = 0; i < values.size(); ++i) {
    left_out.push_back((sum - weights[i] * values[i]) / (total - weights[i]));
  }
  const double centre = weighted_mean(left_out, std::vector<double>(left_out.size(), 1.0));
  double square = 0, cube = 0;
  for (const double mean : left_out) {
    square += std::pow(centre - mean, 2);
    cube += std::pow(centre - mean, 3);
  }
  return square > 0 ? cube / (6 * std::pow(square, 1.5)) : 0.0;
}

/// The quantiles of BCa that stand for `low` and `high` [Efron 1987].
std::pair<double, double> corrected(const std::vector<double>& means, double mean, double low,
                                    double high, double skew) {
  const auto below = std::lower_bound(means.begin(), means.end(), mean) - means.begin();
  const auto not_above = std::upper_bound(means.begin(), means.end(), mean) - means.begin();
  const double share =
      0.5 * static_cast<double>(below + not_above) / static_cast<double>(means.size());
  if (share <= 0 || share >= 1) return {low, high};
  const double bias = normal_quantile(share);
  const auto correct = [&](double p) {
    const double z = bias + normal_quantile(p);
    return normal_cdf(bias + z / (1 - skew * z));
  };
  return {correct(low), correct(high)};
}

/// Ranks of the absolute values from 1, ties sharing their mean; times two, to be whole.
std::vector<int64_t> doubled_ranks(const std::vector<double>& differences) {
  std::vector<size_t> order(differences.size());
  std::iota(order.begin(), order.end(), 0);
  const auto size_at = [&](size_t i) { return std::abs(differences[order[i]]); };
  std::sort(order.begin(), order.end(), [&](size_t a, size_t b) {
    return std::abs(differences[a]) < std::abs(differences[b]);
  });
  std::vector<int64_t> ranks(differences.size());
  for (size_t begin = 0, end; begin < order.size(); begin = end) {
    for (end = begin + 1; end < order.size() && size_at(end) == size_at(begin);) ++end;
    for (size_t i = begin; i < end; ++i) ranks[order[i]] = static_cast<int64_t>(begin + 1 + end);
  }
  return ranks;
}

/// P(the sum of ranks with random signs is at most `sum`).
double exact_tail(const std::vector<int64_t>& ranks, int64_t sum) {
  std::vector<double> share(static_cast<size_t>(sum) + 1, 0.0);
  share[0] = 1;
  for (const int64_t rank : ranks) {
    for (int64_t s = sum; s >= 0; --s) {
      share[s] = 0.5 * (share[s] + (s >= rank ? share[s - rank] : 0.0));
    }
  }
  return std::accumulate(share.begin(), share.end(), 0.0);
}

double approximate_tail(const std::vector<int64_t>& ranks, double sum) {
  double variance = 0, mean = 0;
  for (const int64_t rank : ranks) {
    mean += 0.25 * static_cast<double>(rank);
    variance += std::pow(static_cast<double>(rank), 2) / 16;
  }
  return normal_cdf((sum - mean) / std::sqrt(variance));
}

}  // namespace

void BootstrapOptions::check() const {
  FREETALK_CHECK(num_resamples > 0, "bootstrap num_resamples must be above 0, found ",
                 num_resamples);
  FREETALK_CHECK(confidence > 0 && confidence < 1, "bootstrap confidence must be in (0, 1), found ",
                 confidence);
  FREETALK_CHECK(method == "bca" || method == "percentile",
                 "bootstrap method must be bca or percentile, found ", method);
}

Interval bootstrap_mean(const at::Tensor& values, const at::Tensor& weights,
                        const BootstrapOptions& options, at::Generator generator) {
  options.check();
  const auto x = to_vector(values, "bootstrap_mean", "values");
  const auto w = checked_weights(weights, x.size(), "bootstrap_mean");
  const double mean = weighted_mean(x, w);
  const double unknown = std::numeric_limits<double>::quiet_NaN();
  if (x.size() < 2) return {mean, unknown, unknown};
  const auto [least, most] = std::minmax_element(x.begin(), x.end());
  if (*least == *most) return {mean, mean, mean};
  const auto means = resampled_means(x, w, options.num_resamples, generator);
  double low = (1 - options.confidence) / 2, high = 1 - low;
  if (options.method == "bca") {
    std::tie(low, high) = corrected(means, mean, low, high, acceleration(x, w));
  }
  return {mean, quantile(means, low), quantile(means, high)};
}

PairedTest permutation_test(const at::Tensor& a, const at::Tensor& b, const at::Tensor& weights,
                            int64_t num_resamples, at::Generator generator) {
  const auto x = to_vector(a, "permutation_test", "a");
  const auto y = to_vector(b, "permutation_test", "b");
  FREETALK_CHECK(x.size() == y.size(), "permutation_test: ", x.size(), " values against ", y.size(),
                 ": they must be paired");
  FREETALK_CHECK(num_resamples > 0, "permutation_test: num_resamples must be above 0, found ",
                 num_resamples);
  const auto w = checked_weights(weights, x.size(), "permutation_test");
  const auto count = static_cast<int64_t>(x.size());
  std::vector<double> terms;
  double size = 0;
  for (size_t i = 0; i < x.size(); ++i) {
    terms.push_back(w[i] * (x[i] - y[i]));
    size += std::abs(terms.back());
  }
  const double sum = std::accumulate(terms.begin(), terms.end(), 0.0);
  const double mean = sum / std::accumulate(w.begin(), w.end(), 0.0);
  const double bound = std::abs(sum) - 1e-12 * size;  // sums that differ by rounding are equal
  const bool exact = count < 62 && (int64_t{1} << count) <= num_resamples;
  const int64_t total = exact ? int64_t{1} << count : num_resamples;
  const at::Tensor term = at::tensor(terms, at::kDouble);
  const int64_t rows = std::max<int64_t>(1, kMaxDraws / count);
  int64_t hits = 0;
  for (int64_t done = 0; done < total; done += rows) {
    const int64_t now = std::min(rows, total - done);
    at::Tensor flips;  // (now, N) of 0 and 1
    if (exact) {
      const at::Tensor number = at::arange(done, done + now, at::kLong).unsqueeze(1);
      flips = number.bitwise_right_shift(at::arange(count, at::kLong)).bitwise_and(1);
    } else {
      flips = at::randint(0, 2, {now, count}, generator, at::TensorOptions().dtype(at::kLong));
    }
    const at::Tensor sums = at::mv((1 - 2 * flips).to(at::kDouble), term);
    hits += (sums.abs() >= bound).sum().item<int64_t>();
  }
  const double drawn = exact ? 0 : 1;  // the observed signs count as one of the draws
  return {mean, (drawn + static_cast<double>(hits)) / (drawn + static_cast<double>(total))};
}

PairedTest wilcoxon_test(const at::Tensor& a, const at::Tensor& b) {
  const auto x = to_vector(a, "wilcoxon_test", "a");
  const auto y = to_vector(b, "wilcoxon_test", "b");
  FREETALK_CHECK(x.size() == y.size(), "wilcoxon_test: ", x.size(), " values against ", y.size(),
                 ": they must be paired");
  std::vector<double> differences;
  for (size_t i = 0; i < x.size(); ++i) {
    if (x[i] != y[i]) differences.push_back(x[i] - y[i]);
  }
  const auto ranks = doubled_ranks(differences);
  int64_t above = 0, below = 0;
  for (size_t i = 0; i < ranks.size(); ++i) (differences[i] > 0 ? above : below) += ranks[i];
  const int64_t smaller = std::min(above, below);
  const double statistic = 0.5 * static_cast<double>(smaller);
  if (ranks.empty()) return {0.0, 1.0};
  const double tail = ranks.size() <= kMaxExactPairs ? exact_tail(ranks, smaller)
                                                     : approximate_tail(ranks, statistic);
  return {statistic, std::min(1.0, 2 * tail)};
}

std::vector<double> holm(const std::vector<double>& p_values) {
  std::vector<size_t> order(p_values.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(),
            [&](size_t a, size_t b) { return p_values[a] < p_values[b]; });
  std::vector<double> result(p_values.size());
  double greatest = 0;
  for (size_t i = 0; i < order.size(); ++i) {
    const double p = p_values[order[i]];
    FREETALK_CHECK(p >= 0 && p <= 1, "holm: a p-value must be in [0, 1], found ", p);
    greatest = std::max(greatest, std::min(1.0, p * static_cast<double>(order.size() - i)));
    result[order[i]] = greatest;
  }
  return result;
}

}  // namespace freetalk::metrics
