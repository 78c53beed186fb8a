#include "content_hash.h"

#include <bit>
#include <cstdio>
#include <cstring>

namespace freetalk::geometry {
namespace {

constexpr uint64_t kMultiplier1 = 0x87c37b91114253d5ull;
constexpr uint64_t kMultiplier2 = 0x4cf5ad432745937full;

uint64_t avalanche(uint64_t k) {
  k ^= k >> 33;
  k *= 0xff51afd7ed558ccdull;
  k ^= k >> 33;
  k *= 0xc4ceb9fe1a85ec53ull;
  return k ^ (k >> 33);
}

uint64_t mix1(uint64_t k) { return std::rotl(k * kMultiplier1, 31) * kMultiplier2; }
uint64_t mix2(uint64_t k) { return std::rotl(k * kMultiplier2, 33) * kMultiplier1; }

}  // namespace

void ContentHash::update(const void* data, size_t size) {
  const auto* bytes = static_cast<const unsigned char*>(data);
  uint64_t h1 = high_;
  uint64_t h2 = low_;
  size_t at = 0;
  for (; at + 16 <= size; at += 16) {
    uint64_t words[2];
    std::memcpy(words, bytes + at, 16);
    h1 = (std::rotl(h1 ^ mix1(words[0]), 27) + h2) * 5 + 0x52dce729u;
    h2 = (std::rotl(h2 ^ mix2(words[1]), 31) + h1) * 5 + 0x38495ab5u;
  }
  uint64_t tail[2] = {0, 0};
  std::memcpy(tail, bytes + at, size - at);
  h1 ^= mix1(tail[0]);
  h2 ^= mix2(tail[1]);
  // Finished after every update, so that the boundaries between updates count.
  h1 ^= size;
  h2 ^= size;
  h1 += h2;
  h2 += h1;
  h1 = avalanche(h1);
  h2 = avalanche(h2);
  h1 += h2;
  high_ = h1;
  low_ = h2 + h1;
}

std::string ContentHash::hex() const {
  char text[33];
  std::snprintf(text, sizeof(text), "%016llx%016llx", static_cast<unsigned long long>(high_),
                static_cast<unsigned long long>(low_));
  return text;
}

}  // namespace freetalk::geometry
