// Confidence intervals and paired tests over the sequences of a test set. Values are one number a
// sequence; weights are its frames where a metric is pooled over frames, else 1.
#pragma once

#include <ATen/core/Generator.h>
#include <ATen/core/Tensor.h>

#include <cstdint>
#include <string>
#include <vector>

namespace freetalk::metrics {

struct BootstrapOptions {
  int64_t num_resamples = 10000;
  double confidence = 0.95;    // (0, 1)
  std::string method = "bca";  // "bca" (Efron 1987) or "percentile"
  template <class V>
  void fields(V& v) {
    v("num_resamples", num_resamples);
    v("confidence", confidence);
    v("method", method);
  }
  void check() const;
};

struct Interval {
  double mean = 0, low = 0, high = 0;
};

/// Weighted mean sum w x / sum w, and its confidence interval by resampling sequences with
/// replacement. One sequence has no interval: low and high are NaN. "bca" falls back to
/// "percentile" where all values are equal.
/// @param values, weights (N,) float; weights undefined: all 1.
Interval bootstrap_mean(const at::Tensor& values, const at::Tensor& weights,
                        const BootstrapOptions& options, at::Generator generator);

struct PairedTest {
  double statistic = 0;  ///< what is stated at the test
  double p_value = 1;    ///< two-sided
};

/// Sign-flip permutation test of the weighted mean difference (the statistic), two-sided: exact
/// where 2^N <= num_resamples, else Monte Carlo with p = (1 + hits) / (1 + num_resamples).
/// @param a, b, weights (N,) float, paired by sequence.
PairedTest permutation_test(const at::Tensor& a, const at::Tensor& b, const at::Tensor& weights,
                            int64_t num_resamples, at::Generator generator);

/// Wilcoxon's signed-rank test, two-sided; the statistic is the smaller rank sum. Pairs without a
/// difference are dropped, ties share their mean rank. Exact up to 200 pairs (the distribution
/// given the ties), else the normal approximation with tie correction. [Wilcoxon 1945]
PairedTest wilcoxon_test(const at::Tensor& a, const at::Tensor& b);

/// p-values corrected for their number, in their order. [Holm 1979]
std::vector<double> holm(const std::vector<double>& p_values);

}  // namespace freetalk::metrics
