#include "kernels/block_kernels.h"

#include <new>

#include "kernels/isa.h"

namespace freetalk::kernels {

TallBlock::TallBlock(int64_t rows) : rows_(rows) {
  constexpr size_t kLine = 64;
  const size_t bytes = static_cast<size_t>(rows * kBlockWidth) * sizeof(double);
  data_.reset(static_cast<double*>(std::aligned_alloc(kLine, bytes)));
  if (bytes > 0 && data_ == nullptr) throw std::bad_alloc();
}

namespace {

#define FREETALK_BODY "kernels/block_kernels.inc"
#include "kernels/each_isa.inc"

}  // namespace

const BlockKernels& block_kernels() { return for_isa(isa()); }

}  // namespace freetalk::kernels
