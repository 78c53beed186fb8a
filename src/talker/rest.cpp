#include "rest.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <random>
#include <vector>

namespace freetalk::talker {
namespace {

constexpr double kSilentRms = 3.2e-4;
constexpr double kClosing = 0.07, kOpening = 0.13;  // s
constexpr double kClosure = 0.92;                   // share of the way from lid to lid

/// Lid closure in [0, 1] at a time since the blink began.
double lid(double time) {
  if (time < 0 || time > kClosing + kOpening) return 0;
  const double share = time < kClosing ? time / kClosing : (kClosing + kOpening - time) / kOpening;
  return share * share * (3 - 2 * share);
}

std::vector<double> blink_times(double duration_s, uint64_t seed) {
  // Raw bits, not std::uniform_real_distribution: the same on every platform.
  std::mt19937_64 random(seed);
  const auto uniform = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
  std::vector<double> times;
  for (double at = 0.6 + 2 * uniform(); at < duration_s; at += 2.5 + 3.5 * uniform()) {
    times.push_back(at);
  }
  return times;
}

}  // namespace

bool is_silent(const audio::Audio& audio) {
  const auto window = std::max<size_t>(1, audio.sample_rate_hz / 10);
  for (size_t start = 0; start < audio.samples.size(); start += window) {
    const size_t stop = std::min(start + window, audio.samples.size());
    double sum = 0;
    for (size_t i = start; i < stop; ++i) sum += double{audio.samples[i]} * audio.samples[i];
    if (std::sqrt(sum / static_cast<double>(stop - start)) > kSilentRms) return false;
  }
  return true;
}

at::Tensor rest_motion(const Eigen::MatrixXd& landmarks, int64_t num_frames, double fps,
                       uint64_t seed) {
  constexpr std::array<std::array<int, 2>, 4> kLids = {{{37, 41}, {38, 40}, {43, 47}, {44, 46}}};
  auto motion = at::zeros({num_frames, 68, 3}, at::kFloat);
  auto at_frame = motion.accessor<float, 3>();
  const auto blinks = blink_times(static_cast<double>(num_frames) / fps, seed);
  for (int64_t t = 0; t < num_frames; ++t) {
    const double time = static_cast<double>(t) / fps;
    double closure = 0;
    for (const double blink : blinks) closure = std::max(closure, lid(time - blink));
    for (const auto& [upper, lower] : kLids) {
      for (int axis = 0; axis < 3; ++axis) {
        at_frame[t][upper][axis] = static_cast<float>(
            kClosure * closure * (landmarks(lower, axis) - landmarks(upper, axis)));
      }
    }
    const double breath = 0.5 - 0.5 * std::cos(2 * std::numbers::pi * time / 4.0);
    for (const int nostril : {31, 32, 34, 35}) {
      const double side = landmarks(nostril, 0) > 0 ? 1 : -1;
      at_frame[t][nostril][0] = static_cast<float>(4e-4 * side * breath);
      at_frame[t][nostril][1] = static_cast<float>(3e-4 * breath);
    }
    for (int chin = 6; chin <= 10; ++chin) {
      at_frame[t][chin][1] = static_cast<float>(-4e-4 * breath);
    }
  }
  return motion;
}

}  // namespace freetalk::talker
