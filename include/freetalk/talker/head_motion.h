// How a head moves while it speaks: a little, and more where the voice is loud.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <memory>
#include <vector>

#include "freetalk/audio/audio.h"

namespace freetalk::talker {

/// Rigid motion of a speaking head, learnt from tracked heads: pitch, yaw and roll are each the sum
/// of what follows the voice's loudness (smoothed over 0.3 and 0.8 s) and of a critically damped
/// random motion of its own rate and size, smaller where the voice is quiet. It starts at rest,
/// about the neck, and is causal. The same seed gives the same motion.
/// @returns (num_frames, 4, 4) float64: a point x, m, canonical frame, goes to R x + t.
at::Tensor head_motion(const audio::Audio& audio, int64_t num_frames, double fps, uint64_t seed);

/// The same while the speech is still being heard: the same bits.
class HeadMotionStream {
 public:
  HeadMotionStream(int64_t sample_rate_hz, double fps, uint64_t seed);
  ~HeadMotionStream();
  HeadMotionStream(HeadMotionStream&&) noexcept;
  HeadMotionStream& operator=(HeadMotionStream&&) noexcept;

  void hear(const float* samples, int64_t count);
  /// The next frames. Speech that was not heard a frame beyond the last of them counts as ended.
  at::Tensor next(int64_t num_frames);
  /// Samples held: they do not grow with what has been heard and asked for.
  int64_t num_held() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace freetalk::talker
