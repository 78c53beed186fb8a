#include "freetalk/core/random.h"

#include <ATen/CPUGeneratorImpl.h>
#include <ATen/Context.h>

namespace freetalk::core {

at::Generator make_generator(uint64_t seed, c10::Device device) {
  if (device.is_cpu()) return at::detail::createCPUGenerator(seed);
  at::Generator generator = at::globalContext().defaultGenerator(device).clone();
  generator.set_current_seed(seed);
  return generator;
}

}  // namespace freetalk::core
