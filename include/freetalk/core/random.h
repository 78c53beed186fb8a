// Seeded generators: randomness is always passed in, never global.
#pragma once

#include <ATen/core/Generator.h>
#include <c10/core/Device.h>

#include <cstdint>

namespace freetalk::core {

/// A generator for `device` (CPU or CUDA) that starts from `seed`.
at::Generator make_generator(uint64_t seed, c10::Device device = c10::kCPU);

}  // namespace freetalk::core
