// Autocast for a scope: on in bfloat16, or off.
#pragma once

#include <ATen/autocast_mode.h>
#include <c10/core/impl/LocalDispatchKeySet.h>

namespace freetalk::core {

/// bfloat16 autocast of a device while it lives.
class Bfloat16Scope {
 public:
  /// @param on false: nothing changes.
  explicit Bfloat16Scope(c10::DeviceType device, bool on = true) : device_(device), on_(on) {
    if (!on_) return;
    enabled_ = at::autocast::is_autocast_enabled(device);
    dtype_ = at::autocast::get_autocast_dtype(device);
    at::autocast::increment_nesting();
    at::autocast::set_autocast_enabled(device, true);
    at::autocast::set_autocast_dtype(device, at::kBFloat16);
  }
  ~Bfloat16Scope() {
    if (!on_) return;
    if (at::autocast::decrement_nesting() == 0) at::autocast::clear_cache();
    at::autocast::set_autocast_dtype(device_, dtype_);
    at::autocast::set_autocast_enabled(device_, enabled_);
  }
  Bfloat16Scope(const Bfloat16Scope&) = delete;
  Bfloat16Scope& operator=(const Bfloat16Scope&) = delete;

 private:
  c10::DeviceType device_;
  bool on_, enabled_ = false;
  at::ScalarType dtype_ = at::kFloat;
};

/// No autocast while it lives, whatever the caller's: operations run in their arguments' dtype,
/// which must be one. For what loses its meaning in few digits, such as differences of neighbours.
class NoAutocastScope {
  c10::impl::ExcludeDispatchKeyGuard guard_{c10::autocast_dispatch_keyset};
};

}  // namespace freetalk::core
