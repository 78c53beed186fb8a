// Checks that throw: FREETALK_CHECK for what a caller passed, FREETALK_RUNTIME_CHECK for files and
// numerics.
#pragma once

#include <sstream>
#include <stdexcept>
#include <string>

namespace freetalk::core {

/// Joins its arguments with operator<<.
template <class... Parts>
std::string join(const Parts&... parts) {
  std::ostringstream stream;
  (stream << ... << parts);
  return stream.str();
}

}  // namespace freetalk::core

/// Throws std::invalid_argument (Python ValueError): say what was asked, what was found, what to
/// do.
#define FREETALK_CHECK(condition, ...)                                  \
  do {                                                                  \
    if (!(condition)) {                                                 \
      throw std::invalid_argument(::freetalk::core::join(__VA_ARGS__)); \
    }                                                                   \
  } while (false)

/// Throws std::runtime_error (Python RuntimeError), naming the file or mesh at fault.
#define FREETALK_RUNTIME_CHECK(condition, ...)                       \
  do {                                                               \
    if (!(condition)) {                                              \
      throw std::runtime_error(::freetalk::core::join(__VA_ARGS__)); \
    }                                                                \
  } while (false)
