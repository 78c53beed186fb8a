#include "freetalk/talker/head_motion.h"

#include <ATen/ATen.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Geometry>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <random>

#include "freetalk/core/error.h"
#include "uniform.h"

namespace freetalk::talker {
namespace {

/// Rotation about an axis of the canonical frame. Fitted to the head poses of 948 tracked clips of
/// 3 s (GRID, talker s1: freetalk data from-video); of 135 clips kept apart the loudness alone
/// gives pitch, yaw and roll with correlations of 0.44, 0.28 and 0.29.
struct Axis {
  double fast, slow;  // degrees a unit of loudness smoothed over 0.3 and 0.8 s
  double spread;      // degrees, standard deviation of the rest
  double rate;        // 1/s, of its critically damped motion
  double quiet;       // its speed in silence, a share of that in speech
};
constexpr std::array<Axis, 3> kAxes = {{{-0.75, -0.96, 0.77, 6.4, 0.30},   // pitch, about +x
                                        {1.03, -1.32, 0.60, 2.65, 0.65},   // yaw, about +y
                                        {-0.32, 0.01, 0.31, 3.4, 0.57}}};  // roll, about +z
constexpr double kFastS = 0.3, kSlowS = 0.8;
constexpr double kSpeech = 0.6;                    // loudness of speech, smoothed
constexpr double kRange = 6.0;                     // of the log energy below its peak
constexpr double kSilence = -14.0;                 // log energy
const Eigen::Vector3d kNeck(0.0, -0.092, -0.032);  // m: the point that moved least in those clips

constexpr double kRadians = std::numbers::pi / 180;

double gaussian(std::mt19937_64& random) {
  const double radius = std::sqrt(-2 * std::log1p(-uniform(random)));
  return radius * std::cos(2 * std::numbers::pi * uniform(random));
}

/// Log of the mean squared sample over two frames around a moment.
double log_energy(const audio::Audio& audio, double time_s, double fps) {
  const auto rate = static_cast<double>(audio.sample_rate_hz);
  const auto count = static_cast<int64_t>(audio.samples.size());
  const auto at = [&](double seconds) {
    return std::clamp(static_cast<int64_t>(std::llround(seconds * rate)), int64_t{0}, count);
  };
  const int64_t first = at(time_s - 1 / fps), last = at(time_s + 1 / fps);
  double sum = 0;
  for (int64_t i = first; i < last; ++i) {
    const double sample = audio.samples[static_cast<size_t>(i)];
    sum += sample * sample;
  }
  return std::log(sum / static_cast<double>(std::max<int64_t>(1, last - first)) + 1e-10);
}

/// In [0, 1]: 1 is as loud as the voice has been yet.
class Loudness {
 public:
  double next(double log_energy) {
    peak_ = std::max(peak_, log_energy);
    return log_energy > kSilence ? std::clamp(1 + (log_energy - peak_) / kRange, 0.0, 1.0) : 0.0;
  }

 private:
  double peak_ = kSilence;
};

/// x'' + 2 a x' + a^2 x = noise, of unit variance, stepped exactly.
class Wander {
 public:
  Wander(double rate, double step_s) {
    const double a = rate, h = step_s, decay = std::exp(-a * h);
    step_ << 1 + a * h, h, -a * a * h, 1 - a * h;
    step_ *= decay;
    const Eigen::Matrix2d settled = Eigen::Vector2d(1, a * a).asDiagonal();
    noise_ = (settled - step_ * settled * step_.transpose()).llt().matrixL();
  }
  /// @param amount of the noise.
  double next(double amount, std::mt19937_64& random) {
    const double first = gaussian(random), second = gaussian(random);
    state_ = step_ * state_ + amount * (noise_ * Eigen::Vector2d(first, second));
    return state_[0];
  }

 private:
  Eigen::Matrix2d step_, noise_;
  Eigen::Vector2d state_ = Eigen::Vector2d::Zero();
};

Eigen::Matrix4d about_neck(const Eigen::Vector3d& angles) {
  const Eigen::Matrix3d turn = (Eigen::AngleAxisd(angles[1], Eigen::Vector3d::UnitY()) *
                                Eigen::AngleAxisd(angles[0], Eigen::Vector3d::UnitX()) *
                                Eigen::AngleAxisd(angles[2], Eigen::Vector3d::UnitZ()))
                                   .toRotationMatrix();
  Eigen::Matrix4d pose = Eigen::Matrix4d::Identity();
  pose.topLeftCorner<3, 3>() = turn;
  pose.topRightCorner<3, 1>() = kNeck - turn * kNeck;
  return pose;
}

}  // namespace

at::Tensor head_motion(const audio::Audio& audio, int64_t num_frames, double fps, uint64_t seed) {
  FREETALK_CHECK(num_frames > 0 && fps > 0, "head_motion: expected frames and a frame rate, found ",
                 num_frames, " at ", fps);
  std::mt19937_64 random(seed);
  Loudness loudness;
  std::array<Wander, 3> wander = {Wander(kAxes[0].rate, 1 / fps), Wander(kAxes[1].rate, 1 / fps),
                                  Wander(kAxes[2].rate, 1 / fps)};
  const double keep_fast = std::exp(-1 / (fps * kFastS)), keep_slow = std::exp(-1 / (fps * kSlowS));
  double fast = 0, slow = 0;
  const at::Tensor result = at::empty({num_frames, 4, 4}, at::kDouble);
  for (int64_t t = 0; t < num_frames; ++t) {
    const double loud = loudness.next(log_energy(audio, static_cast<double>(t) / fps, fps));
    fast += (1 - keep_fast) * (loud - fast);
    slow += (1 - keep_slow) * (loud - slow);
    Eigen::Vector3d angles;
    for (int k = 0; k < 3; ++k) {
      const Axis& axis = kAxes[static_cast<size_t>(k)];
      const double amount = axis.quiet + (1 - axis.quiet) * std::min(1.0, fast / kSpeech);
      const double own = wander[static_cast<size_t>(k)].next(amount, random);
      angles[k] = kRadians * (axis.fast * fast + axis.slow * slow + axis.spread * own);
    }
    const Eigen::Matrix<double, 4, 4, Eigen::RowMajor> pose = about_neck(angles);
    result[t].copy_(at::from_blob(const_cast<double*>(pose.data()), {4, 4}, at::kDouble));
  }
  return result;
}

}  // namespace freetalk::talker
