#include "statistics.h"

#include <torch/torch.h>

#include <algorithm>
#include <cmath>

namespace freetalk::speech {
namespace {

constexpr double kWaveEpsilon = 1e-7;  // of `transformers`' feature extractor
constexpr double kNormEpsilon = 1e-5;  // of torch's group norm
constexpr int64_t kBlockValues = 1 << 20;

/// Adds the windows of a wave to their sum (k,) and the sum of their outer products (k, k).
void add_windows(const at::Tensor& wave, int64_t stride, int64_t count, at::Tensor& sum,
                 at::Tensor& products) {
  const int64_t kernel = sum.size(0);
  const auto samples = wave.to(at::kDouble).contiguous();
  const int64_t block = std::max<int64_t>(1, kBlockValues / kernel);
  for (int64_t first = 0; first < count; first += block) {
    const int64_t rows = std::min(block, count - first);
    const auto windows =
        samples.as_strided({rows, kernel}, {stride, 1}, samples.storage_offset() + first * stride)
            .contiguous();
    sum += windows.sum(0);
    products.addmm_(windows.t(), windows);
  }
}

WindowMoments make_moments(const at::Tensor& sum, const at::Tensor& products, int64_t count) {
  const auto mean = sum / static_cast<double>(count);
  return {mean, products / static_cast<double>(count) - at::outer(mean, mean)};
}

}  // namespace

FoldedNorm fold_group_norm(const at::Tensor& weight, const at::Tensor& gamma,
                           const at::Tensor& beta, const WindowMoments& moments) {
  const auto w = weight.detach().squeeze(1).to(at::kCPU, at::kDouble);  // (C, k)
  const auto mean = at::mv(w, moments.mean);
  const auto variance = (at::mm(w, moments.covariance) * w).sum(1).clamp_min(0.0);
  const auto scale = gamma.detach().to(mean.options()) / (variance + kNormEpsilon).sqrt();
  const auto bias = beta.detach().to(mean.options()) - scale * mean;
  const auto result = weight.options().dtype(at::kFloat).requires_grad(false);
  return {(w * scale.unsqueeze(1)).unsqueeze(1).to(result), bias.to(result)};
}

WindowMoments window_moments(const at::Tensor& wave, int64_t kernel, int64_t stride,
                             int64_t num_windows) {
  auto sum = at::zeros({kernel}, at::kDouble);
  auto products = at::zeros({kernel, kernel}, at::kDouble);
  const int64_t count = num_windows >= 0 ? num_windows : (wave.size(0) - kernel) / stride + 1;
  add_windows(wave.detach().cpu(), stride, count, sum, products);
  return make_moments(sum, products, count);
}

WaveStatistics::WaveStatistics(int64_t kernel, int64_t stride) : kernel_(kernel), stride_(stride) {
  if (kernel_ > 0) {
    pending_ = at::empty({0}, at::kFloat);
    window_sum_ = at::zeros({kernel_}, at::kDouble);
    products_ = at::zeros({kernel_, kernel_}, at::kDouble);
  }
}

void WaveStatistics::add(const at::Tensor& samples) {
  if (samples.size(0) == 0) {
    return;
  }
  const auto wide = samples.to(at::kDouble);
  num_samples_ += samples.size(0);
  sum_ += wide.sum().item<double>();
  sum_of_squares_ += wide.square().sum().item<double>();
  if (kernel_ == 0) {
    return;
  }
  auto wave = at::cat({pending_, samples.to(at::kFloat)});
  const int64_t dropped = std::min(num_to_skip_, wave.size(0));
  wave = wave.slice(0, dropped);
  num_to_skip_ -= dropped;
  const int64_t count = wave.size(0) < kernel_ ? 0 : (wave.size(0) - kernel_) / stride_ + 1;
  add_windows(wave, stride_, count, window_sum_, products_);
  num_windows_ += count;
  const int64_t used = std::min(count * stride_, wave.size(0));
  num_to_skip_ += count * stride_ - used;
  pending_ = wave.slice(0, used).clone();
}

double WaveStatistics::mean() const { return sum_ / static_cast<double>(num_samples_); }

double WaveStatistics::variance() const {
  return std::max(0.0, sum_of_squares_ / static_cast<double>(num_samples_) - mean() * mean());
}

at::Tensor WaveStatistics::normalize(const at::Tensor& samples) const {
  return (samples - mean()) / std::sqrt(variance() + kWaveEpsilon);
}

WindowMoments WaveStatistics::moments() const {
  if (num_windows_ == 0) {
    return {};
  }
  auto moments = make_moments(window_sum_, products_, num_windows_);
  const double scale = variance() + kWaveEpsilon;
  return {(moments.mean - mean()) / std::sqrt(scale), moments.covariance / scale};
}

}  // namespace freetalk::speech
