// What a user should know but no result says: a cache that cannot be written, a fallback that was
// taken.
#pragma once

#include <functional>
#include <string>

namespace freetalk::core {

enum class LogLevel { kDebug, kInfo, kWarning, kError };

/// Takes one sentence without a line break. Called on whichever thread has something to say, one
/// call at a time per thread; must not throw.
using LogSink = std::function<void(LogLevel level, const std::string& text)>;

/// Where sentences go from now on. @param sink empty: warnings and errors to stderr, as at the
/// start.
void set_log_sink(LogSink sink);

/// Hands a sentence to the sink. Safe from any thread.
void log(LogLevel level, const std::string& text);

}  // namespace freetalk::core
