// Smooth transitions from one value to another.
#pragma once

#include <algorithm>

namespace freetalk::core {

/// 0 up to 0, 1 from 1 on, without a kink between.
inline double smoothstep(double u) {
  u = std::clamp(u, 0.0, 1.0);
  return u * u * (3 - 2 * u);
}

/// 1 below `near`, 0 beyond `far`, smooth between.
inline double fade(double distance, double near, double far) {
  return 1 - smoothstep((distance - near) / (far - near));
}

}  // namespace freetalk::core
