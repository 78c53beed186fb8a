// A value computed when it is first asked for, once, whichever thread asks first.
#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <utility>

namespace freetalk::core {

template <class T>
class Deferred {
 public:
  explicit Deferred(std::function<T()> make) : make_(std::move(make)) {}

  /// The value; where making it throws, the next call tries again.
  const T& get() const {
    std::call_once(once_, [this] {
      value_.emplace(make_());
      make_ = nullptr;  // lets go of what it was made from
    });
    return *value_;
  }

 private:
  mutable std::once_flag once_;
  mutable std::function<T()> make_;
  mutable std::optional<T> value_;
};

template <class Make>
auto defer(Make make) {
  using T = decltype(make());
  return std::make_shared<const Deferred<T>>(std::move(make));
}

}  // namespace freetalk::core
