// 128-bit hash of bytes (MurmurHash3 x64 128, A. Appleby, public domain algorithm): cache keys and
// checksums.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace freetalk::geometry {

class ContentHash {
 public:
  void update(const void* data, size_t size);
  /// 32 hexadecimal digits of everything so far.
  std::string hex() const;

 private:
  uint64_t high_ = 0;
  uint64_t low_ = 0;
};

}  // namespace freetalk::geometry
