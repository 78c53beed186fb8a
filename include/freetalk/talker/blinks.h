// Blinks where the model leaves the eyes open for long.
#pragma once

#include <ATen/core/Tensor.h>

#include <Eigen/Core>
#include <cstdint>
#include <deque>
#include <limits>
#include <random>

namespace freetalk::talker {

/// Closes the lids at random moments, twelve times a minute, for 0.38 s, closing faster than
/// opening, as tracked eyes do; a blink within 1.5 s of one that the motion has itself is left out.
/// The same seed gives the same blinks.
/// @param motion (T, 68, 3) float32 m, changed in place. @param landmarks (68, 3) m, the
/// template's.
void add_blinks(at::Tensor& motion, const Eigen::MatrixXd& landmarks, double fps, uint64_t seed);

/// When blinks are due: the same moments for the same seed, on every platform.
class BlinkTimes {
 public:
  explicit BlinkTimes(uint64_t seed);
  /// s, of the blink that is due.
  double next() const { return next_; }
  void advance();

 private:
  double wait();
  std::mt19937_64 random_;
  double next_ = 0;
};

/// The same for motion whose future is not known: a blink is left out if the motion had one of its
/// own in the 1.5 s before, and the eyes' usual opening is that of the last five seconds.
class BlinkStream {
 public:
  BlinkStream(const Eigen::MatrixXd& landmarks, double fps, uint64_t seed);
  /// @param motion (t, 68, 3) float32 m, the next frames, changed in place.
  void add(at::Tensor& motion);

 private:
  Eigen::MatrixXd landmarks_;
  double fps_;
  BlinkTimes times_;
  std::deque<double> openings_;
  int64_t frame_ = 0;
  double own_ = -std::numeric_limits<double>::infinity();    // last closed by the motion itself, s
  double blink_ = -std::numeric_limits<double>::infinity();  // began last, s
};

}  // namespace freetalk::talker
