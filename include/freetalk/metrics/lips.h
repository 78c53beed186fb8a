// What lips do with speech: how far they open, whether they close where they must, how late they
// are.
#pragma once

#include <ATen/core/Tensor.h>

#include <string>
#include <vector>

namespace freetalk::metrics {

/// Gap of the lips: mean over pairs of (m[upper] - m[lower]) . up. Of displacements it is the
/// change against the neutral face.
/// @param motion (B, T, V, 3). @param upper, lower (P,) int64, vertices that face one another.
/// @param up (3,) float, unit vector to the top of the head. @returns (B, T) float64.
at::Tensor lip_opening(const at::Tensor& motion, const at::Tensor& upper, const at::Tensor& lower,
                       const at::Tensor& up);

/// Pearson's correlation of two series over valid frames; 0 where one of them is constant.
/// @param a, b (B, T) float. @param valid (B, T) bool, or undefined. @returns (B,) float64.
at::Tensor correlation(const at::Tensor& a, const at::Tensor& b, const at::Tensor& valid = {});

/// A speech sound and its interval in seconds; labels are ARPABET without stress.
struct Phone {
  double start_s = 0, end_s = 0;
  std::string label;
};

struct ClosureOptions {
  double closed =
      0;  ///< opening of closed lips, in the unit of the series; 0: as in the neutral face
  double share = 0.15;  ///< of the largest opening that still counts as closed, [0, 1)
  double largest = 0;   ///< the largest opening; 0: that of the series itself
  void check() const;
};

/// For each p, b, m that begins within the series: do the lips close during it? Closed is an
/// opening of at most closed + share (largest - closed). The rate is the mean of the answers.
/// @param opening (T,) float.
std::vector<bool> lip_closures(const at::Tensor& opening, const std::vector<Phone>& phones,
                               double fps, const ClosureOptions& options = {});

/// Log of the audio's energy around each frame (Hann window of two frames).
/// @param wave (S,) float. @returns (num_frames,) float64.
at::Tensor log_energy(const at::Tensor& wave, int64_t num_frames, double fps,
                      double sample_rate_hz);

/// The shift at which two series agree best.
struct Offset {
  double offset_ms = 0;    ///< above 0: `follower` is late
  double correlation = 0;  ///< Pearson's correlation at the nearest whole frame
};

/// Offset of `follower` (the lips) against `leader` (the audio's energy, or the true lips): the
/// whole-frame lag of at most `max_offset_ms` whose overlap correlates most (the smallest such
/// lag), refined by the parabola through it and its neighbours. Series that are constant give 0.
/// @param follower, leader (T,) float, T at least four frames longer than the largest lag.
Offset best_offset(const at::Tensor& follower, const at::Tensor& leader, double fps,
                   double max_offset_ms = 300);

}  // namespace freetalk::metrics
