#include "core/parallel.h"

#include <ATen/Parallel.h>
#include <ATen/ThreadLocalState.h>
#include <pthread.h>

#include <algorithm>
#include <atomic>

namespace freetalk::core {
namespace {

std::atomic<bool> forked{false};

// OpenMP's threads do not live on in a child, which would wait for them for ever. Registered when
// the library is loaded: torch may start threads before the first loop of ours.
[[maybe_unused]] const int registered = pthread_atfork(nullptr, nullptr, [] { forked = true; });

#ifdef _OPENMP
bool serial() { return forked || at::in_parallel_region(); }
#else
bool serial() { return true; }  // at::parallel_for knows OpenMP alone.
#endif

}  // namespace

void parallel_for(int64_t begin, int64_t end, int64_t grain,
                  const std::function<void(int64_t, int64_t)>& body) {
  if (begin >= end) return;
  if (serial() || end - begin <= grain || at::get_num_threads() == 1) {
    body(begin, end);
    return;
  }
  const at::ThreadLocalState state;
  at::parallel_for(begin, end, grain, [&](int64_t first, int64_t last) {
    const at::ThreadLocalStateGuard guard(state);
    body(first, last);
  });
}

void parallel_tasks(int64_t count, int64_t workers,
                    const std::function<void(int64_t, int64_t)>& body) {
  std::atomic<int64_t> next{0};
  parallel_for(0, std::min({count, workers, num_threads()}), 1, [&](int64_t first, int64_t last) {
    for (int64_t worker = first; worker < last; ++worker) {
      try {
        for (int64_t index = next++; index < count; index = next++) body(index, worker);
      } catch (...) {
        next = count;
        throw;
      }
    }
  });
}

int64_t num_threads() { return serial() ? 1 : at::get_num_threads(); }

}  // namespace freetalk::core
