// How a head moves while it speaks: a little, and more where the voice is loud.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>

#include "freetalk/audio/audio.h"

namespace freetalk::talker {

/// Rigid motion of a speaking head, learnt from tracked heads: pitch, yaw and roll are each the sum
/// of what follows the voice's loudness (smoothed over 0.3 and 0.8 s) and of a critically damped
/// random motion of its own rate and size, smaller where the voice is quiet. It starts at rest,
/// about the neck, and is causal. The same seed gives the same motion.
/// @returns (num_frames, 4, 4) float64: a point x, m, canonical frame, goes to R x + t.
at::Tensor head_motion(const audio::Audio& audio, int64_t num_frames, double fps, uint64_t seed);

}  // namespace freetalk::talker
