#include "kernels/fused_kernels.h"

#include <cstring>

#include "kernels/isa.h"

#if defined(__x86_64__) && defined(__GNUC__)
#ifndef __clang__
// The intrinsics' "undefined" operands are deliberately not set, which GCC 12 takes for a mistake.
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif
#include <immintrin.h>
#endif

namespace freetalk::kernels {
namespace {

constexpr int64_t kSoftmaxWork = 128;  // floats; scores have fewer

#define FREETALK_BODY "kernels/fused_kernels.inc"
#define FREETALK_BFLOAT16_BODY "kernels/fused_kernels_bfloat16.inc"
#include "kernels/each_isa.inc"

}  // namespace

const Kernels<float>& float_kernels() { return for_isa(isa()); }

const Kernels<uint16_t>* bfloat16_kernels() {
#ifdef FREETALK_X86_KERNELS
  if (isa() >= Isa::avx512_bf16) return &bfloat16::kernels();
#endif
  return nullptr;
}

}  // namespace freetalk::kernels
