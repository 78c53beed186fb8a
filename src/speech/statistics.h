// What normalisation needs to know of a clip, gathered piece by piece.
//
// The wave is normalised to zero mean and unit variance, and group norm (HuBERT and wav2vec 2.0
// base) normalises each channel of the first convolution over the whole clip. That convolution is
// linear: channel c at position i is w_c . u_i + b_c for the window u_i of samples under its
// kernel, so its mean and variance follow from the mean and the covariance of the windows,
//   mean_c = w_c . E[u] + b_c,  var_c = w_cᵀ Cov[u] w_c,
// without computing the convolution. A clip can be normalised as a whole though it is encoded in
// pieces, and the norm becomes part of the convolution's weights.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>

namespace freetalk::speech {

/// Mean (k,) and covariance (k, k) of the windows of samples under the first kernel, double.
struct WindowMoments {
  at::Tensor mean, covariance;
};

/// The first convolution with its group norm as one convolution.
struct FoldedNorm {
  at::Tensor weight;  // (C, 1, k) float
  at::Tensor bias;    // (C,) float
};

/// Folds group norm with one channel a group, epsilon 1e-5.
/// @param weight (C, 1, k) of the convolution; its bias cancels
/// @param gamma, beta (C,) of the norm
FoldedNorm fold_group_norm(const at::Tensor& weight, const at::Tensor& gamma,
                           const at::Tensor& beta, const WindowMoments& moments);

/// Moments of one wave (S,) float with windows of `kernel` samples every `stride`, all of them or
/// the first `num_windows`.
WindowMoments window_moments(const at::Tensor& wave, int64_t kernel, int64_t stride,
                             int64_t num_windows = -1);

/// Sums over a wave that comes in pieces.
class WaveStatistics {
 public:
  /// @param kernel, stride of the first convolution; 0 leaves window moments out
  WaveStatistics(int64_t kernel, int64_t stride);

  /// @param samples (n,) float, the next ones
  void add(const at::Tensor& samples);

  /// (x - mean) / sqrt(variance + 1e-7) with the statistics so far.
  at::Tensor normalize(const at::Tensor& samples) const;

  /// Moments of the windows of the normalised wave so far; undefined tensors before
  /// the first window is complete.
  WindowMoments moments() const;

 private:
  double mean() const;
  double variance() const;

  int64_t kernel_, stride_;
  int64_t num_samples_ = 0, num_windows_ = 0;
  int64_t num_to_skip_ = 0;  // samples to come before the next window, if strides exceed the kernel
  double sum_ = 0.0, sum_of_squares_ = 0.0;
  at::Tensor pending_;                // samples that windows to come reach back to
  at::Tensor window_sum_, products_;  // (k,), (k, k) double
};

}  // namespace freetalk::speech
