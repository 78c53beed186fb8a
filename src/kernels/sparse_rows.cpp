#include "kernels/sparse_rows.h"

#include <tuple>

#include "kernels/isa.h"

namespace freetalk::kernels {
namespace {

template <class Value, class Index>
using MultiplyRows = void (*)(const SparseRows<Value, Index>& matrix, int64_t begin, int64_t end,
                              const Value* x, int64_t channels, Value* y);

using SparseKernels = std::tuple<MultiplyRows<float, int32_t>, MultiplyRows<float, int64_t>,
                                 MultiplyRows<double, int32_t>, MultiplyRows<double, int64_t>>;

#define FREETALK_BODY "kernels/sparse_rows.inc"
#include "kernels/each_isa.inc"

}  // namespace

template <class Value, class Index>
void multiply_rows(const SparseRows<Value, Index>& matrix, int64_t begin, int64_t end,
                   const Value* x, int64_t channels, Value* y) {
  std::get<MultiplyRows<Value, Index>>(for_isa(isa()))(matrix, begin, end, x, channels, y);
}

#define FREETALK_INSTANTIATE(VALUE, INDEX)                                                     \
  template void multiply_rows(const SparseRows<VALUE, INDEX>&, int64_t, int64_t, const VALUE*, \
                              int64_t, VALUE*);
FREETALK_INSTANTIATE(float, int32_t)
FREETALK_INSTANTIATE(float, int64_t)
FREETALK_INSTANTIATE(double, int32_t)
FREETALK_INSTANTIATE(double, int64_t)
#undef FREETALK_INSTANTIATE

}  // namespace freetalk::kernels
