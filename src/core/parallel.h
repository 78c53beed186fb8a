// The one door to parallel loops.
#pragma once

#include <cstdint>
#include <functional>

namespace freetalk::core {

/// Calls body(first, last) on pieces of [begin, end) of at least `grain` (but for the last), on as
/// many threads as torch may use (at::set_num_threads). Grad mode, autocast and the rest of torch's
/// thread-local state are the caller's in every piece; the first exception reaches the caller.
/// One piece, on the caller's thread: inside another parallel loop, in a fork of a process, whose
/// threads are gone, and where the compiler has no OpenMP.
void parallel_for(int64_t begin, int64_t end, int64_t grain,
                  const std::function<void(int64_t, int64_t)>& body);

/// Calls body(index, worker) for each index in [0, count) on at most `workers` threads: a thread
/// that is done takes the next index, so indices that cost most come first. `worker`, below
/// `workers` and num_threads(), says whose work space to use; after an exception no index is begun.
void parallel_tasks(int64_t count, int64_t workers,
                    const std::function<void(int64_t, int64_t)>& body);

/// The number of pieces that run at the same time in a loop started here: 1 inside another one.
int64_t num_threads();

}  // namespace freetalk::core
