#include "kernels/isa.h"

#include <array>
#include <atomic>
#include <cstdlib>

#include "freetalk/core/error.h"

namespace freetalk::kernels {
namespace {

constexpr std::array<const char*, 4> kNames{"baseline", "avx2", "avx512", "avx512_bf16"};
constexpr int kNoScope = -1;
std::atomic<int> scoped{kNoScope};

Isa detected() {
#if defined(__x86_64__) && defined(__GNUC__)
  if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma")) return Isa::baseline;
  if (!__builtin_cpu_supports("avx512f") || !__builtin_cpu_supports("avx512bw") ||
      !__builtin_cpu_supports("avx512vl") || !__builtin_cpu_supports("avx512dq")) {
    return Isa::avx2;
  }
  return __builtin_cpu_supports("avx512bf16") ? Isa::avx512_bf16 : Isa::avx512;
#else
  return Isa::baseline;
#endif
}

Isa wanted() {
  const char* text = std::getenv("FREETALK_ISA");
  if (text == nullptr || *text == '\0') return best_isa();
  std::string available;
  for (int level = 0; level <= static_cast<int>(best_isa()); ++level) {
    const std::string name = kNames[static_cast<size_t>(level)];
    if (name == text) return static_cast<Isa>(level);
    available += (available.empty() ? "" : ", ") + name;
  }
  FREETALK_CHECK(false, "FREETALK_ISA is \"", text, "\", but this processor has: ", available,
                 "; name one of these, or unset it");
  return Isa::baseline;
}

}  // namespace

std::string isa_name(Isa level) { return kNames[static_cast<size_t>(level)]; }

Isa best_isa() {
  static const Isa best = detected();
  return best;
}

Isa isa() {
  const int level = scoped.load(std::memory_order_relaxed);
  if (level != kNoScope) return static_cast<Isa>(level);
  static const Isa chosen = wanted();
  return chosen;
}

IsaScope::IsaScope(Isa level) : before_(scoped) {
  FREETALK_CHECK(level <= best_isa(), "this processor has no ", isa_name(level));
  scoped = static_cast<int>(level);
}

IsaScope::~IsaScope() { scoped = before_; }

}  // namespace freetalk::kernels
