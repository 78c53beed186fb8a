#include "rest.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "freetalk/core/conventions.h"

namespace freetalk::talker {
namespace {

constexpr double kSilentRms = 3.2e-4;

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

at::Tensor rest_motion(const Eigen::MatrixXd& landmarks, int64_t num_frames, double fps) {
  auto motion = at::zeros({num_frames, core::kNumLandmarks, 3}, at::kFloat);
  auto at_frame = motion.accessor<float, 3>();
  for (int64_t t = 0; t < num_frames; ++t) {
    const double time = static_cast<double>(t) / fps;
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
