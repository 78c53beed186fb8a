#include "kernels/block_kernels.h"

#include <new>

namespace freetalk::kernels {

TallBlock::TallBlock(int64_t rows) : rows_(rows) {
  constexpr size_t kLine = 64;
  const size_t bytes = static_cast<size_t>(rows * kBlockWidth) * sizeof(double);
  data_.reset(static_cast<double*>(std::aligned_alloc(kLine, bytes)));
  if (bytes > 0 && data_ == nullptr) throw std::bad_alloc();
}

namespace {

namespace baseline {
#include "kernels/block_kernels_body.h"
constexpr BlockKernels kKernels{add_gram, subtract_product, solve_lower, solve_upper};
}  // namespace baseline

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define FREETALK_WIDE_KERNELS

#pragma GCC push_options
#pragma GCC target("avx2,fma")
namespace avx2 {
#include "kernels/block_kernels_body.h"
constexpr BlockKernels kKernels{add_gram, subtract_product, solve_lower, solve_upper};
}  // namespace avx2
#pragma GCC pop_options

#pragma GCC push_options
#pragma GCC target("avx512f,avx2,fma")
namespace avx512 {
#include "kernels/block_kernels_body.h"
constexpr BlockKernels kKernels{add_gram, subtract_product, solve_lower, solve_upper};
}  // namespace avx512
#pragma GCC pop_options
#endif

}  // namespace

const BlockKernels& block_kernels() {
#ifdef FREETALK_WIDE_KERNELS
  if (__builtin_cpu_supports("avx512f")) return avx512::kKernels;
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return avx2::kKernels;
#endif
  return baseline::kKernels;
}

}  // namespace freetalk::kernels
