#include "kernels/fused_kernels.h"

#include <cstring>

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define FREETALK_X86_KERNELS 1
// The intrinsics' "undefined" operands are deliberately not set, which GCC 12 takes for a mistake.
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#include <immintrin.h>
#endif

namespace freetalk::kernels {
namespace {

constexpr int64_t kSoftmaxWork = 128;  // floats; scores have fewer

namespace baseline {
#define FREETALK_LANES 4
#define FREETALK_ROWS 6
#include "fused_kernels.inc"
#undef FREETALK_LANES
#undef FREETALK_ROWS
}  // namespace baseline

#ifdef FREETALK_X86_KERNELS
#pragma GCC push_options
#pragma GCC target("avx2,fma")
namespace avx2 {
#define FREETALK_LANES 8
#define FREETALK_ROWS 6
#include "fused_kernels.inc"
#undef FREETALK_LANES
#undef FREETALK_ROWS
}  // namespace avx2
#pragma GCC pop_options

#pragma GCC push_options
#pragma GCC target("avx512f,avx512bw,avx512vl,avx512dq,fma,prefer-vector-width=512")
namespace avx512 {
#define FREETALK_LANES 16
#define FREETALK_ROWS 12
#include "fused_kernels.inc"
#undef FREETALK_LANES
#undef FREETALK_ROWS
}  // namespace avx512
#pragma GCC pop_options

#pragma GCC push_options
#pragma GCC target("avx512f,avx512bw,avx512vl,avx512dq,avx512bf16,fma,prefer-vector-width=512")
namespace bfloat16 {
#define FREETALK_LANES 16
#define FREETALK_ROWS 12
namespace floats {
#include "fused_kernels.inc"
}  // namespace floats
#include "fused_kernels_bfloat16.inc"
#undef FREETALK_LANES
#undef FREETALK_ROWS
}  // namespace bfloat16
#pragma GCC pop_options
#endif

}  // namespace

const Kernels<float>& float_kernels() {
#ifdef FREETALK_X86_KERNELS
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
      __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq")) {
    return avx512::kernels();
  }
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return avx2::kernels();
#endif
  return baseline::kernels();
}

const Kernels<uint16_t>* bfloat16_kernels() {
#ifdef FREETALK_X86_KERNELS
  if (__builtin_cpu_supports("avx512bf16") && __builtin_cpu_supports("avx512bw") &&
      __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq")) {
    return &bfloat16::kernels();
  }
#endif
  return nullptr;
}

}  // namespace freetalk::kernels
