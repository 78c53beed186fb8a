// The one choice of instruction set: every table of kernels is compiled for each level
// (each_isa.inc) and picked by the level in use.
#pragma once

#include <string>

namespace freetalk::kernels {

/// What a level holds, it holds of those before as well. Other processors than x86-64 have the
/// baseline alone.
enum class Isa {
  baseline,    // what the compiler assumes anyway: SSE2 on x86-64, NEON on aarch64
  avx2,        // with FMA
  avx512,      // F, BW, VL, DQ
  avx512_bf16  // products of bfloat16
};

/// "baseline", "avx2", "avx512", "avx512_bf16".
std::string isa_name(Isa level);

/// The highest level of this processor.
Isa best_isa();

/// The level in use: the environment variable FREETALK_ISA names one, at most best_isa(); read
/// once.
/// @throws std::invalid_argument naming the levels there are, where it names none of them
Isa isa();

/// Another level while it lives, in every thread; nested ones end in reverse order. For tests.
class IsaScope {
 public:
  /// @param level at most best_isa()
  explicit IsaScope(Isa level);
  ~IsaScope();
  IsaScope(const IsaScope&) = delete;
  IsaScope& operator=(const IsaScope&) = delete;

 private:
  int before_;
};

}  // namespace freetalk::kernels
