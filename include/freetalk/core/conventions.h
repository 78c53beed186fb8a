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

/// Upper and lower landmarks that face each other at the inner lips, and at the lids.
inline constexpr int kFirstInnerLip = 60;
inline constexpr std::array<std::array<int, 2>, 3> kInnerLips{{{61, 67}, {62, 66}, {63, 65}}};
inline constexpr std::array<std::array<int, 2>, 4> kLids{{{37, 41}, {38, 40}, {43, 47}, {44, 46}}};

/// A landmark of a lip, and the pair of kInnerLips whose gap it goes with.
struct LipLandmark {
  int landmark, pair;
};
inline constexpr std::array<LipLandmark, 8> kUpperLip{
    {{49, 0}, {50, 0}, {51, 1}, {52, 2}, {53, 2}, {61, 0}, {62, 1}, {63, 2}}};
inline constexpr std::array<LipLandmark, 8> kLowerLip{
    {{59, 0}, {58, 0}, {57, 1}, {56, 2}, {55, 2}, {67, 0}, {66, 1}, {65, 2}}};

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
