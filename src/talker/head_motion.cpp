#include "freetalk/talker/head_motion.h"

#include <ATen/ATen.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Geometry>

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
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

struct HeadMotionStream::State {
  double rate, fps;
  std::mt19937_64 random;
  Loudness loudness;
  std::array<Wander, 3> wander;
  double fast = 0, slow = 0;
  std::deque<float> samples;  // from `first` on
  int64_t first = 0, frame = 0;

  State(int64_t sample_rate_hz, double frames_per_s, uint64_t seed)
      : rate(static_cast<double>(sample_rate_hz)),
        fps(frames_per_s),
        random(seed),
        wander{Wander(kAxes[0].rate, 1 / fps), Wander(kAxes[1].rate, 1 / fps),
               Wander(kAxes[2].rate, 1 / fps)} {}

  /// Log of the mean squared sample over two frames around the next frame's moment; lets go of what
  /// no later frame hears.
  double log_energy() {
    const double time_s = static_cast<double>(frame) / fps;
    const int64_t heard = first + static_cast<int64_t>(samples.size());
    const auto at = [&](double seconds) {
      return std::clamp(static_cast<int64_t>(std::llround(seconds * rate)), first, heard);
    };
    const int64_t begin = at(time_s - 1 / fps), end = at(time_s + 1 / fps);
    samples.erase(samples.begin(), samples.begin() + (begin - first));
    first = begin;
    double sum = 0;
    for (int64_t i = 0; i < end - begin; ++i) {
      const double sample = samples[static_cast<size_t>(i)];
      sum += sample * sample;
    }
    return std::log(sum / static_cast<double>(std::max<int64_t>(1, end - begin)) + 1e-10);
  }

  Eigen::Vector3d next() {
    const double keep_fast = std::exp(-1 / (fps * kFastS));
    const double keep_slow = std::exp(-1 / (fps * kSlowS));
    const double loud = loudness.next(log_energy());
    fast += (1 - keep_fast) * (loud - fast);
    slow += (1 - keep_slow) * (loud - slow);
    ++frame;
    Eigen::Vector3d angles;
    for (int k = 0; k < 3; ++k) {
      const Axis& axis = kAxes[static_cast<size_t>(k)];
      const double amount = axis.quiet + (1 - axis.quiet) * std::min(1.0, fast / kSpeech);
      const double own = wander[static_cast<size_t>(k)].next(amount, random);
      angles[k] = kRadians * (axis.fast * fast + axis.slow * slow + axis.spread * own);
    }
    return angles;
  }
};

HeadMotionStream::HeadMotionStream(int64_t sample_rate_hz, double fps, uint64_t seed) {
  FREETALK_CHECK(sample_rate_hz > 0 && fps > 0, "head motion: expected rates, found ",
                 sample_rate_hz, " Hz and ", fps, " frames per second");
  state_ = std::make_unique<State>(sample_rate_hz, fps, seed);
}

HeadMotionStream::~HeadMotionStream() = default;
HeadMotionStream::HeadMotionStream(HeadMotionStream&&) noexcept = default;
HeadMotionStream& HeadMotionStream::operator=(HeadMotionStream&&) noexcept = default;

void HeadMotionStream::hear(const float* samples, int64_t count) {
  state_->samples.insert(state_->samples.end(), samples, samples + count);
}

at::Tensor HeadMotionStream::next(int64_t num_frames) {
  const at::Tensor result = at::empty({num_frames, 4, 4}, at::kDouble);
  for (int64_t t = 0; t < num_frames; ++t) {
    const Eigen::Matrix<double, 4, 4, Eigen::RowMajor> pose = about_neck(state_->next());
    result[t].copy_(at::from_blob(const_cast<double*>(pose.data()), {4, 4}, at::kDouble));
  }
  return result;
}

int64_t HeadMotionStream::num_held() const { return static_cast<int64_t>(state_->samples.size()); }

at::Tensor head_motion(const audio::Audio& audio, int64_t num_frames, double fps, uint64_t seed) {
  FREETALK_CHECK(num_frames > 0, "head_motion: expected frames, found ", num_frames);
  HeadMotionStream stream(audio.sample_rate_hz, fps, seed);
  stream.hear(audio.samples.data(), static_cast<int64_t>(audio.samples.size()));
  return stream.next(num_frames);
}

}  // namespace freetalk::talker
