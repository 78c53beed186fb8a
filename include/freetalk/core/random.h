// Seeded generators: randomness is always passed in, never global.
#pragma once

#include <ATen/core/Generator.h>
#include <c10/core/Device.h>

#include <cstdint>

namespace freetalk::core {

/// A generator for `device` (CPU or CUDA) that starts from `seed`.
at::Generator make_generator(uint64_t seed, c10::Device device = c10::kCPU);

/// The `index`-th number of splitmix64 begun at `seed` (S. Vigna): neighbours share nothing.
constexpr uint64_t splitmix64(uint64_t seed, uint64_t index) {
  uint64_t value = seed + (index + 1) * 0x9E3779B97F4A7C15ULL;
  value = (value ^ (value >> 30)) * 0xBF58476D1CE4E5B9ULL;
  value = (value ^ (value >> 27)) * 0x94D049BB133111EBULL;
  return value ^ (value >> 31);
}

}  // namespace freetalk::core
