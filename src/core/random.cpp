#include "freetalk/core/random.h"

#include <ATen/CPUGeneratorImpl.h>
#include <ATen/Context.h>

namespace freetalk::core {

at::Generator make_generator(uint64_t seed, c10::Device device) {
  // Tensors of meta have no numbers to draw, and no generator: any will do.
  if (device.is_cpu() || device.is_meta()) return at::detail::createCPUGenerator(seed);
  at::Generator generator = at::globalContext().defaultGenerator(device).clone();
  generator.set_current_seed(seed);
  return generator;
}

}  // namespace freetalk::core
