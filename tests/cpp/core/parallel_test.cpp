#include "core/parallel.h"

#include <ATen/Parallel.h>
#include <c10/core/GradMode.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <mutex>
#include <set>
#include <stdexcept>
#include <thread>
#include <vector>

namespace freetalk::core {
namespace {

/// torch's number of threads while it lives.
class Threads {
 public:
  explicit Threads(int count) : before_(at::get_num_threads()) { at::set_num_threads(count); }
  ~Threads() { at::set_num_threads(before_); }

 private:
  int before_;
};

/// The threads that run a loop of `threads` pieces, each of which waits for the others.
size_t threads_seen(int threads) {
  std::mutex mutex;
  std::set<std::thread::id> seen;
  std::atomic<int> arrived{0};
  parallel_for(0, threads, 1, [&](int64_t begin, int64_t end) {
    const auto patience = std::chrono::steady_clock::now() + std::chrono::seconds(20);
    arrived += static_cast<int>(end - begin);
    while (arrived < threads && std::chrono::steady_clock::now() < patience) {
      std::this_thread::yield();
    }
    const std::lock_guard lock(mutex);
    seen.insert(std::this_thread::get_id());
  });
  return seen.size();
}

TEST(Parallel, RunsOnAsManyThreadsAsTorchMayUse) {
  for (const int threads : {1, 2, 4}) {
    const Threads scope(threads);
    EXPECT_EQ(num_threads(), threads);
    EXPECT_EQ(threads_seen(threads), static_cast<size_t>(threads));
  }
}

TEST(Parallel, CallsEachIndexOnceInPiecesOfTheGrain) {
  const Threads scope(3);
  std::vector<std::atomic<int>> calls(100);
  std::mutex mutex;
  std::vector<int64_t> sizes;
  parallel_for(7, 100, 20, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) ++calls[static_cast<size_t>(i)];
    const std::lock_guard lock(mutex);
    sizes.push_back(end - begin);
  });
  for (int64_t i = 0; i < 100; ++i) EXPECT_EQ(calls[static_cast<size_t>(i)], i < 7 ? 0 : 1) << i;
  EXPECT_GT(sizes.size(), 1u);
  for (const int64_t size : sizes) EXPECT_GE(size, 20);
  parallel_for(5, 5, 1, [](int64_t, int64_t) { FAIL() << "an empty range was called"; });
}

TEST(Parallel, TasksAreDoneOnceByWorkersBelowTheBound) {
  const Threads scope(4);
  std::vector<std::atomic<int>> calls(500);
  std::atomic<int> beyond{0};
  parallel_tasks(500, 3, [&](int64_t index, int64_t worker) {
    ++calls[static_cast<size_t>(index)];
    if (worker < 0 || worker >= 3) ++beyond;
  });
  for (const auto& count : calls) EXPECT_EQ(count, 1);
  EXPECT_EQ(beyond, 0);
}

TEST(Parallel, CarriesTheCallersGradModeIntoEveryPiece) {
  const Threads scope(4);
  for (const bool enabled : {false, true}) {
    const c10::AutoGradMode mode(enabled);
    std::atomic<int> same{0};
    parallel_for(0, 4, 1, [&](int64_t begin, int64_t end) {
      if (c10::GradMode::is_enabled() == enabled) same += static_cast<int>(end - begin);
    });
    EXPECT_EQ(same, 4);
    EXPECT_EQ(c10::GradMode::is_enabled(), enabled);
  }
}

TEST(Parallel, CarriesAnExceptionToTheCaller) {
  const Threads scope(4);
  const auto fail = [](int64_t index, int64_t) {
    if (index == 3) throw std::runtime_error("third");
  };
  try {
    parallel_tasks(1000, 4, fail);
    FAIL() << "nothing was thrown";
  } catch (const std::runtime_error& error) {
    EXPECT_STREQ(error.what(), "third");
  }
  EXPECT_EQ(threads_seen(4), 4u);  // and the threads are there as before
}

TEST(Parallel, IsSerialWithinALoop) {
  const Threads scope(2);
  std::atomic<int> pieces{0}, most{0};
  parallel_for(0, 2, 1, [&](int64_t, int64_t) {
    most = std::max<int>(most, static_cast<int>(num_threads()));
    parallel_for(0, 1000, 1, [&](int64_t, int64_t) { ++pieces; });
  });
  EXPECT_EQ(pieces, 2);
  EXPECT_EQ(most, 1);
}

TEST(Parallel, WorksInAForkOfAProcessThatHasRunThreads) {
  const Threads scope(4);
  ASSERT_EQ(threads_seen(4), 4u);
  const pid_t child = fork();
  if (child == 0) {
    std::atomic<int64_t> sum{0};
    parallel_for(0, 100, 1, [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) sum += i;
    });
    _exit(sum == 4950 && num_threads() == 1 ? 0 : 1);
  }
  int status = -1;
  pid_t done = 0;
  for (int wait = 0; wait < 2000 && done == 0; ++wait) {  // a child that hangs is ended, and fails
    done = waitpid(child, &status, WNOHANG);
    if (done == 0) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  if (done == 0) {
    kill(child, SIGKILL);
    waitpid(child, &status, 0);
  }
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  EXPECT_EQ(threads_seen(4), 4u);
}

}  // namespace
}  // namespace freetalk::core
