#include "freetalk/talker/blinks.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/smoothstep.h"
#include "freetalk/core/conventions.h"
#include "uniform.h"

namespace freetalk::talker {
namespace {

using Positions = at::TensorAccessor<float, 3>;

// The median course of 187 tracked blinks that stand alone (GRID, talker s1, 25 fps: freetalk data
// from-video), fitted with lid() below.
constexpr double kClosing = 0.15, kOpening = 0.23;  // s
constexpr double kDuration = kClosing + kOpening;
// Blinks a minute: 40.1 of s1 (47 minutes), 5.1 of four other talkers of GRID together (12 s); the
// mean of the five. Half a second after one of s1's, the next is as likely at any moment.
constexpr double kPerMinute = 12.1;
constexpr double kClosure = 0.96;  // share of the way from lid to lid
constexpr double kClosed = 0.5;    // of the usual opening
constexpr double kApart = 1.5;     // s, from one blink to the next at least
constexpr double kRemembered = 5;  // s, over which a stream knows the usual opening

/// Lid closure in [0, 1] at a time since the blink began.
double lid(double time) {
  const double left = kDuration - time;
  return core::smoothstep(std::min(time / kClosing, left / kOpening));
}

double opening_of(const at::TensorAccessor<float, 2>& frame, const Eigen::MatrixXd& landmarks) {
  double opening = 0;
  for (const auto& [upper, lower] : core::kLids) {
    opening += landmarks(upper, 1) + frame[upper][1] - landmarks(lower, 1) - frame[lower][1];
  }
  return opening;
}

template <class Numbers>
double median(const Numbers& numbers) {
  if (numbers.empty()) return 0;
  std::vector<double> sorted(numbers.begin(), numbers.end());
  const auto middle = sorted.begin() + static_cast<int64_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  return *middle;
}

/// Brings the upper lids down to the lower ones by a share of the way.
void close_lids(at::TensorAccessor<float, 2> frame, const Eigen::MatrixXd& landmarks,
                double closure) {
  for (const auto& [upper, lower] : core::kLids) {
    for (int axis = 0; axis < 3; ++axis) {
      const double gap =
          landmarks(lower, axis) + frame[lower][axis] - landmarks(upper, axis) - frame[upper][axis];
      frame[upper][axis] += static_cast<float>(closure * gap);
    }
  }
}

/// Seconds at which the motion itself has the eyes closed.
std::vector<double> closed_times(const Positions& motion, const Eigen::MatrixXd& landmarks,
                                 double fps) {
  std::vector<double> opening;
  for (int64_t t = 0; t < motion.size(0); ++t) {
    opening.push_back(opening_of(motion[t], landmarks));
  }
  const double closed = kClosed * median(opening);
  std::vector<double> times;
  for (size_t t = 0; t < opening.size(); ++t) {
    if (opening[t] < closed) times.push_back(static_cast<double>(t) / fps);
  }
  return times;
}

}  // namespace

void add_blinks(at::Tensor& motion, const Eigen::MatrixXd& landmarks, double fps, uint64_t seed) {
  auto frames = motion.accessor<float, 3>();
  const std::vector<double> own = closed_times(frames, landmarks, fps);
  const double duration_s = static_cast<double>(frames.size(0)) / fps;
  for (BlinkTimes times(seed); times.next() < duration_s; times.advance()) {
    const auto near = [&](double time) { return std::abs(time - times.next()) < kApart; };
    if (std::any_of(own.begin(), own.end(), near)) continue;
    for (auto t = static_cast<int64_t>(std::ceil(times.next() * fps)); t < frames.size(0); ++t) {
      const double time = static_cast<double>(t) / fps - times.next();
      if (time > kDuration) break;
      close_lids(frames[t], landmarks, kClosure * lid(time));
    }
  }
}

BlinkTimes::BlinkTimes(uint64_t seed) : random_(seed) { next_ = wait(); }

double BlinkTimes::wait() { return -(60 / kPerMinute - kApart) * std::log1p(-uniform(random_)); }

void BlinkTimes::advance() { next_ += kApart + wait(); }

BlinkStream::BlinkStream(const Eigen::MatrixXd& landmarks, double fps, uint64_t seed)
    : landmarks_(landmarks), fps_(fps), times_(seed) {}

void BlinkStream::add(at::Tensor& motion) {
  auto frames = motion.accessor<float, 3>();
  const auto remembered = static_cast<size_t>(std::ceil(kRemembered * fps_));
  for (int64_t t = 0; t < frames.size(0); ++t, ++frame_) {
    const double time = static_cast<double>(frame_) / fps_;
    openings_.push_back(opening_of(frames[t], landmarks_));
    if (openings_.size() > remembered) openings_.pop_front();
    if (openings_.back() < kClosed * median(openings_)) own_ = time;
    for (; times_.next() <= time; times_.advance()) {
      if (times_.next() - own_ >= kApart) blink_ = times_.next();
    }
    if (time - blink_ <= kDuration) {
      close_lids(frames[t], landmarks_, kClosure * lid(time - blink_));
    }
  }
}

}  // namespace freetalk::talker
