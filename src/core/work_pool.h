// Work spaces that outlive a call: one is taken by each thread that works, and left for the next.
#pragma once

#include <memory>
#include <mutex>
#include <utility>
#include <vector>

namespace freetalk::core {

/// Safe to use from several threads; holds as many as were ever in use at a time.
template <class Work>
class WorkPool {
 public:
  /// Null where none is left over.
  std::unique_ptr<Work> take() {
    const std::lock_guard lock(mutex_);
    if (idle_.empty()) return nullptr;
    std::unique_ptr<Work> work = std::move(idle_.back());
    idle_.pop_back();
    return work;
  }
  void give(std::unique_ptr<Work> work) {
    if (!work) return;
    const std::lock_guard lock(mutex_);
    idle_.push_back(std::move(work));
  }

 private:
  std::mutex mutex_;
  std::vector<std::unique_ptr<Work>> idle_;
};

}  // namespace freetalk::core
