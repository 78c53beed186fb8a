#include "core/parallel.h"

#include <ATen/Parallel.h>
#include <ATen/ThreadLocalState.h>
#include <pthread.h>

#include <atomic>

namespace freetalk::core {
namespace {

std::atomic<bool> forked{false};

bool serial() {
  // OpenMP's threads do not live on in a child, which would wait for them for ever.
  [[maybe_unused]] static const int registered =
      pthread_atfork(nullptr, nullptr, [] { forked = true; });
  return forked || at::in_parallel_region();
}

}  // namespace

void parallel_for(int64_t begin, int64_t end, int64_t grain,
                  const std::function<void(int64_t, int64_t)>& body) {
  if (begin >= end) return;
  if (serial()) {
    body(begin, end);
    return;
  }
  const at::ThreadLocalState state;
  at::parallel_for(begin, end, grain, [&](int64_t first, int64_t last) {
    const at::ThreadLocalStateGuard guard(state);
    body(first, last);
  });
}

int64_t num_threads() { return serial() ? 1 : at::get_num_threads(); }

}  // namespace freetalk::core
