// What all rooms take for granted: landmarks, units of length, frames.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

namespace freetalk::core {

/// Landmarks of a face: those of iBUG / Multi-PIE, in their order.
inline constexpr int64_t kNumLandmarks = 68;              // N
inline constexpr int64_t kMotionDim = 3 * kNumLandmarks;  // D

struct Unit {
  const char* name;
  double metres;
};

/// The units of length that meshes come in.
inline constexpr std::array<Unit, 4> kUnits{
    {{"m", 1.0}, {"cm", 0.01}, {"mm", 0.001}, {"in", 0.0254}}};

/// Motion frames of a clip: round(duration * fps), at least 1.
inline int64_t num_frames(double duration_s, double fps) {
  return std::max<int64_t>(1, std::llround(duration_s * fps));
}

}  // namespace freetalk::core
