#include "freetalk/core/log.h"

#include <cstdio>
#include <memory>
#include <mutex>
#include <utility>

namespace freetalk::core {
namespace {

struct Sink {
  std::mutex mutex;
  std::shared_ptr<const LogSink> current;
};

Sink& sink() {
  static auto* const instance = new Sink;  // outlives threads that still speak at exit
  return *instance;
}

}  // namespace

void set_log_sink(LogSink next) {
  auto owned = next ? std::make_shared<const LogSink>(std::move(next)) : nullptr;
  const std::lock_guard lock(sink().mutex);
  sink().current.swap(owned);
}

void log(LogLevel level, const std::string& text) {
  std::shared_ptr<const LogSink> current;
  {
    // Called outside the lock: a sink may wait for another thread that wants to speak itself.
    const std::lock_guard lock(sink().mutex);
    current = sink().current;
  }
  if (current) {
    (*current)(level, text);
  } else if (level >= LogLevel::kWarning) {
    std::fprintf(stderr, "freetalk: %s\n", text.c_str());
  }
}

}  // namespace freetalk::core
