#include "combine_rows.h"

#include <algorithm>
#include <vector>

#include "core/parallel.h"
#include "fused_kernels.h"

namespace freetalk::kernels {
namespace {

constexpr int64_t kColumns = 256;  // of a block: stays in the first cache with 100 rows or fewer

}  // namespace

void combine_rows(const float* weights, int64_t num_sums, int64_t num_rows, const float* rows,
                  int64_t columns, float* out) {
  const Kernels<float>& kernels = float_kernels();
  const int64_t blocks = (columns + kColumns - 1) / kColumns;
  core::parallel_for(0, blocks, 1, [&](int64_t begin, int64_t end) {
    std::vector<float> part(static_cast<size_t>(num_rows * kColumns)), packed(part.size()),
        sums(static_cast<size_t>(kTile * kColumns));
    for (int64_t block = begin; block < end; ++block) {
      const int64_t first = block * kColumns, count = std::min(kColumns, columns - first);
      for (int64_t row = 0; row < num_rows; ++row) {
        float* target = part.data() + row * kColumns;
        std::copy_n(rows + row * columns + first, count, target);
        std::fill(target + count, target + kColumns, 0.0F);
      }
      kernels.pack(part.data(), num_rows, kColumns, packed.data());
      for (int64_t sum = 0; sum < num_sums; sum += kTile) {
        const int64_t height = std::min(kTile, num_sums - sum);
        const Segment<float> segment{weights + sum * num_rows, num_rows, packed.data(), num_rows};
        kernels.product(&segment, 1, height, kColumns, {}, sums.data(), nullptr, kColumns);
        for (int64_t row = 0; row < height; ++row) {
          std::copy_n(sums.data() + row * kColumns, count, out + (sum + row) * columns + first);
        }
      }
    }
  });
}

}  // namespace freetalk::kernels
