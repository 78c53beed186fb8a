// The boundary between LibTorch's exceptions and the documented ones.
#pragma once

#include <c10/util/Exception.h>

#include <stdexcept>
#include <string>
#include <utility>

#include "freetalk/core/error.h"

namespace freetalk::core {

/// Calls `work`; what LibTorch throws (c10::Error: a tensor on another device, no memory on the
/// GPU) becomes a std::runtime_error of one sentence without its stack trace. Everything else
/// passes.
/// @param what asked for, in front of the sentence
template <class Work>
decltype(auto) with_plain_errors(const char* what, Work&& work) {
  try {
    return std::forward<Work>(work)();
  } catch (const c10::Error& error) {
    const std::string message = error.what_without_backtrace();
    throw std::runtime_error(join(what, ": ", message.substr(0, message.find('\n'))));
  }
}

}  // namespace freetalk::core
