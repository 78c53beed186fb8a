// Random numbers that are the same on every platform.
#pragma once

#include <random>

namespace freetalk::talker {

/// In [0, 1), of raw bits: std::uniform_real_distribution differs between libraries.
inline double uniform(std::mt19937_64& random) {
  return static_cast<double>(random() >> 11) * 0x1p-53;
}

}  // namespace freetalk::talker
