#include "freetalk/metrics/lips.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>

#include "freetalk/core/error.h"
#include "select.h"

namespace freetalk::metrics {
namespace {

constexpr int64_t kLeastOverlap = 4;  // frames from which a correlation is formed

void check_series(const at::Tensor& series, const char* metric, const char* name) {
  FREETALK_CHECK(
      series.defined() && series.dim() == 1 && series.numel() > 0 && series.is_floating_point(),
      metric, ": expected ", name, " (T,) floating point and not empty, found ",
      series.defined() ? c10::str(series.sizes(), " ", series.scalar_type()) : "nothing");
}

/// Pearson's correlation of `count` values; 0 where one series is constant.
double pearson(const double* a, const double* b, int64_t count) {
  double mean_a = 0, mean_b = 0;
  for (int64_t t = 0; t < count; ++t) mean_a += a[t], mean_b += b[t];
  mean_a /= static_cast<double>(count), mean_b /= static_cast<double>(count);
  double aa = 0, bb = 0, ab = 0;
  for (int64_t t = 0; t < count; ++t) {
    const double da = a[t] - mean_a, db = b[t] - mean_b;
    aa += da * da, bb += db * db, ab += da * db;
  }
  // A spread below 1e-12 is rounding, not motion.
  const double least = 1e-24 * static_cast<double>(count);
  return aa < least || bb < least ? 0.0 : ab / std::sqrt(aa * bb);
}

}  // namespace

at::Tensor lip_opening(const at::Tensor& motion, const at::Tensor& upper, const at::Tensor& lower,
                       const at::Tensor& up) {
  check_motion(motion, "lip_opening", "motion");
  FREETALK_CHECK(upper.dim() == 1 && upper.sizes() == lower.sizes(),
                 "lip_opening: expected upper and lower (P,) of equal length, found ",
                 upper.sizes(), " and ", lower.sizes());
  FREETALK_CHECK(up.dim() == 1 && up.size(0) == 3 && up.is_floating_point() &&
                     std::abs(up.norm().item<double>() - 1) < 1e-6,
                 "lip_opening: up must be a unit vector (3,)");
  const auto side = [&](const at::Tensor& indices) {
    return take_vertices(motion, vertex_indices({indices, {}, {}}, motion, "lip_opening"));
  };
  const at::Tensor axis = up.to(motion.device(), at::kDouble);
  return at::matmul(side(upper) - side(lower), axis).mean(2);  // (B, T, P) -> (B, T)
}

at::Tensor correlation(const at::Tensor& a, const at::Tensor& b, const at::Tensor& valid) {
  FREETALK_CHECK(a.dim() == 2 && a.sizes() == b.sizes() && a.numel() > 0 && a.is_floating_point() &&
                     b.is_floating_point(),
                 "correlation: expected two (B, T) floating point, found ", a.sizes(), " and ",
                 b.sizes());
  const at::Tensor frames = valid_frames(valid, a, 1, "correlation").cpu();
  at::Tensor result = at::empty({a.size(0)}, at::kDouble);
  for (int64_t i = 0; i < a.size(0); ++i) {
    const at::Tensor kept = frames[i].nonzero().squeeze(1);
    const auto row = [&](const at::Tensor& x) {
      return x[i].to(at::kCPU, at::kDouble).index_select(0, kept).contiguous();
    };
    const at::Tensor left = row(a), right = row(b);
    result[i] = pearson(left.data_ptr<double>(), right.data_ptr<double>(), left.numel());
  }
  return result.to(a.device());
}

void ClosureOptions::check() const {
  FREETALK_CHECK(share >= 0 && share < 1, "lip_closures: share must be in [0, 1), found ", share);
  FREETALK_CHECK(largest >= 0, "lip_closures: largest must not be below 0, found ", largest);
}

std::vector<bool> lip_closures(const at::Tensor& opening, const std::vector<Phone>& phones,
                               double fps, const ClosureOptions& options) {
  check_series(opening, "lip_closures", "opening");
  FREETALK_CHECK(fps > 0, "lip_closures: fps must be above 0, found ", fps);
  options.check();
  const at::Tensor series = opening.to(at::kCPU, at::kDouble).contiguous();
  const double* begin = series.data_ptr<double>();
  const double* end = begin + series.numel();
  const double largest = options.largest > 0 ? options.largest : *std::max_element(begin, end);
  const double limit = options.closed + options.share * std::max(largest - options.closed, 1e-6);
  std::vector<bool> result;
  for (const auto& phone : phones) {
    if (phone.label != "P" && phone.label != "B" && phone.label != "M") continue;
    const auto first = static_cast<int64_t>(std::nearbyint(phone.start_s * fps));
    const auto last = static_cast<int64_t>(std::nearbyint(phone.end_s * fps));
    if (first < 0 || first >= series.numel()) continue;
    const double* stop = std::min(begin + std::max(last, first + 1), end);
    result.push_back(*std::min_element(begin + first, stop) <= limit);
  }
  return result;
}

at::Tensor log_energy(const at::Tensor& wave, int64_t num_frames, double fps,
                      double sample_rate_hz) {
  check_series(wave, "log_energy", "wave");
  FREETALK_CHECK(num_frames > 0 && fps > 0 && sample_rate_hz >= fps,
                 "log_energy: num_frames and fps must be above 0 and the sample rate at least fps");
  const auto half = static_cast<int64_t>(std::nearbyint(sample_rate_hz / fps));
  const int64_t width = 2 * half + 1;
  const at::Tensor window = at::hann_window(width, /*periodic=*/false, at::kDouble);
  const at::Tensor padded = at::constant_pad_nd(wave.to(at::kCPU, at::kDouble), {half, 2 * half});
  const int64_t last = padded.numel() - width;
  at::Tensor energy = at::empty({num_frames}, at::kDouble);
  for (int64_t t = 0; t < num_frames; ++t) {
    const auto start =
        static_cast<int64_t>(std::nearbyint(static_cast<double>(t) * sample_rate_hz / fps));
    energy[t] = (padded.narrow(0, std::min(start, last), width) * window).square().mean();
  }
  const double floor = std::max(1e-10, 1e-6 * energy.max().item<double>());
  return (energy + floor).log();
}

Offset best_offset(const at::Tensor& follower, const at::Tensor& leader, double fps,
                   double max_offset_ms) {
  check_series(follower, "best_offset", "follower");
  check_series(leader, "best_offset", "leader");
  FREETALK_CHECK(follower.sizes() == leader.sizes(), "best_offset: the series have ",
                 follower.numel(), " and ", leader.numel(), " frames");
  FREETALK_CHECK(fps > 0 && max_offset_ms >= 0,
                 "best_offset: fps must be above 0 and max_offset_ms not below 0");
  const auto largest = static_cast<int64_t>(std::floor(max_offset_ms * fps / 1000 + 1e-9));
  const int64_t count = follower.numel();
  FREETALK_CHECK(count >= largest + kLeastOverlap, "best_offset: ", count,
                 " frames are too few for offsets of ", max_offset_ms, " ms at ", fps, " fps");
  const at::Tensor late = follower.to(at::kCPU, at::kDouble).contiguous();
  const at::Tensor early = leader.to(at::kCPU, at::kDouble).contiguous();
  const double *a = late.data_ptr<double>(), *b = early.data_ptr<double>();
  const auto at_lag = [&](int64_t lag) {
    return lag >= 0 ? pearson(a + lag, b, count - lag) : pearson(a, b - lag, count + lag);
  };
  int64_t best = 0;
  double highest = at_lag(0);
  for (int64_t lag = 1; lag <= largest; ++lag) {
    for (const int64_t signed_lag : {lag, -lag}) {
      const double value = at_lag(signed_lag);
      if (value > highest) highest = value, best = signed_lag;
    }
  }
  double shift = 0;
  if (std::abs(best) < largest) {
    const double before = at_lag(best - 1), after = at_lag(best + 1);
    const double bend = before - 2 * highest + after;
    if (bend < 0) shift = std::clamp(0.5 * (before - after) / bend, -0.5, 0.5);
  }
  return {1000 * (static_cast<double>(best) + shift) / fps, highest};
}

}  // namespace freetalk::metrics
