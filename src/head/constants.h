// Numbers of NPHM's code that its options do not name.
#pragma once

#include <cstdint>

namespace freetalk::head {

inline constexpr double kDistanceOffset = 1e-5;       // added to distances from anchors
inline constexpr double kBackgroundExponent = -20.0;  // of the background's weight
inline constexpr int64_t kMaxMembers = 128;

}  // namespace freetalk::head
