#include "freetalk/nn/sparse.h"

#include <torch/csrc/autograd/custom_function.h>
#include <torch/library.h>
#include <torch/torch.h>

#include <algorithm>

#include "core/autocast.h"
#include "core/parallel.h"
#include "freetalk/core/error.h"
#include "kernels/sparse_rows.h"

namespace freetalk::nn {
namespace {

using at::Tensor;
using geometry::SparseOperator;

constexpr char kName[] = "freetalk::sparse_product";
constexpr int64_t kGrain = 512;  // rows; below that a thread costs more than it saves

using Signature = Tensor(const Tensor& rows, const Tensor& columns, const Tensor& values,
                         const Tensor& transposed_rows, const Tensor& transposed_columns,
                         const Tensor& transposed_values, const Tensor& x);

Tensor call(const SparseOperator& a, const Tensor& x) {
  static const auto op =
      c10::Dispatcher::singleton().findSchemaOrThrow(kName, "").typed<Signature>();
  return op.call(a.rows, a.columns, a.values, a.transposed_rows, a.transposed_columns,
                 a.transposed_values, x);
}

void check(const SparseOperator& a, const Tensor& x) {
  FREETALK_CHECK(x.dim() == 3 && x.size(1) == a.num_columns(), "sparse_product: expected x (B, ",
                 a.num_columns(), ", C), found ", x.sizes());
  FREETALK_CHECK(x.scalar_type() == a.values.scalar_type(), "sparse_product: expected x of type ",
                 a.values.scalar_type(), ", found ", x.scalar_type());
}

template <class Value, class Index>
void multiply(const SparseOperator& a, const Tensor& x, Tensor& y) {
  const Tensor rows = a.rows.contiguous(), columns = a.columns.contiguous(),
               values = a.values.contiguous();
  const kernels::SparseRows<Value, Index> matrix{rows.const_data_ptr<Index>(),
                                                 columns.const_data_ptr<Index>(),
                                                 values.const_data_ptr<Value>()};
  const int64_t num_rows = y.size(1), channels = x.size(2), of_frame = x.size(1) * channels;
  const auto* from = x.const_data_ptr<Value>();
  auto* to = y.data_ptr<Value>();
  core::parallel_for(0, x.size(0) * num_rows, kGrain, [&](int64_t begin, int64_t end) {
    while (begin < end) {  // a frame's rows at a time
      const int64_t frame = begin / num_rows, row = begin % num_rows;
      const int64_t count = std::min(end - begin, num_rows - row);
      kernels::multiply_rows(matrix, row, row + count, from + frame * of_frame, channels,
                             to + begin * channels);
      begin += count;
    }
  });
}

Tensor composed(const Tensor& rows, const Tensor& columns, const Tensor& values,
                const Tensor& transposed_rows, const Tensor& transposed_columns,
                const Tensor& transposed_values, const Tensor& x) {
  const SparseOperator a{
      rows, columns, values, transposed_rows, transposed_columns, transposed_values};
  check(a, x);
  const Tensor flat = x.transpose(0, 1).reshape({x.size(1), x.size(0) * x.size(2)});  // (V, B C)
  return a.to_sparse_csr()
      .matmul(flat)
      .view({a.num_rows(), x.size(0), x.size(2)})
      .transpose(0, 1)
      .contiguous();
}

Tensor on_cpu(const Tensor& rows, const Tensor& columns, const Tensor& values,
              const Tensor& transposed_rows, const Tensor& transposed_columns,
              const Tensor& transposed_values, const Tensor& x) {
  const SparseOperator a{
      rows, columns, values, transposed_rows, transposed_columns, transposed_values};
  const auto type = x.scalar_type();
  if (type != at::kFloat && type != at::kDouble) {
    return composed(rows, columns, values, transposed_rows, transposed_columns, transposed_values,
                    x);
  }
  check(a, x);
  const Tensor dense = x.contiguous();
  Tensor y = at::empty({x.size(0), a.num_rows(), x.size(2)}, dense.options());
  const bool narrow = rows.scalar_type() == at::kInt;
  if (type == at::kFloat) {
    narrow ? multiply<float, int32_t>(a, dense, y) : multiply<float, int64_t>(a, dense, y);
  } else {
    narrow ? multiply<double, int32_t>(a, dense, y) : multiply<double, int64_t>(a, dense, y);
  }
  return y;
}

Tensor on_meta(const Tensor& rows, const Tensor&, const Tensor&, const Tensor&, const Tensor&,
               const Tensor&, const Tensor& x) {
  return at::empty_symint({x.sym_size(0), rows.sym_size(0) - 1, x.sym_size(2)}, x.options());
}

class Product : public torch::autograd::Function<Product> {
 public:
  static Tensor forward(torch::autograd::AutogradContext* context, const Tensor& rows,
                        const Tensor& columns, const Tensor& values, const Tensor& transposed_rows,
                        const Tensor& transposed_columns, const Tensor& transposed_values,
                        const Tensor& x) {
    context->save_for_backward(
        {transposed_rows, transposed_columns, transposed_values, rows, columns, values});
    const at::AutoDispatchBelowADInplaceOrView below;
    return call({rows, columns, values, transposed_rows, transposed_columns, transposed_values}, x);
  }
  static torch::autograd::tensor_list backward(torch::autograd::AutogradContext* context,
                                               torch::autograd::tensor_list gradients) {
    const auto a = context->get_saved_variables();  // the transpose
    torch::autograd::tensor_list result(7);
    result[6] = call({a[0], a[1], a[2], a[3], a[4], a[5]}, gradients[0]);
    return result;
  }
};

Tensor with_gradient(const Tensor& rows, const Tensor& columns, const Tensor& values,
                     const Tensor& transposed_rows, const Tensor& transposed_columns,
                     const Tensor& transposed_values, const Tensor& x) {
  FREETALK_CHECK(!values.requires_grad() && !transposed_values.requires_grad(),
                 "sparse_product: the matrix is a constant, but its values require a gradient");
  return Product::apply(rows, columns, values, transposed_rows, transposed_columns,
                        transposed_values, x);
}

// Differences of neighbours drown in the few digits of bfloat16 and float16.
Tensor without_autocast(const Tensor& rows, const Tensor& columns, const Tensor& values,
                        const Tensor& transposed_rows, const Tensor& transposed_columns,
                        const Tensor& transposed_values, const Tensor& x) {
  const core::NoAutocastScope no_autocast;
  return call({rows, columns, values, transposed_rows, transposed_columns, transposed_values},
              x.to(values.scalar_type()));
}

TORCH_LIBRARY(freetalk, library) {
  library.def(
      "sparse_product(Tensor rows, Tensor columns, Tensor values, Tensor transposed_rows, "
      "Tensor transposed_columns, Tensor transposed_values, Tensor x) -> Tensor");
}
TORCH_LIBRARY_IMPL(freetalk, CPU, library) { library.impl("sparse_product", on_cpu); }
TORCH_LIBRARY_IMPL(freetalk, CompositeExplicitAutograd, library) {
  library.impl("sparse_product", composed);
}
TORCH_LIBRARY_IMPL(freetalk, Meta, library) { library.impl("sparse_product", on_meta); }
TORCH_LIBRARY_IMPL(freetalk, Autograd, library) { library.impl("sparse_product", with_gradient); }
TORCH_LIBRARY_IMPL(freetalk, AutocastCPU, library) {
  library.impl("sparse_product", without_autocast);
}
TORCH_LIBRARY_IMPL(freetalk, AutocastCUDA, library) {
  library.impl("sparse_product", without_autocast);
}

}  // namespace

Tensor sparse_product(const SparseOperator& matrix, const Tensor& x) {
  FREETALK_CHECK(x.dim() == 3 && x.size(1) == matrix.num_columns(),
                 "sparse_product: expected x (B, ", matrix.num_columns(), ", C), found ",
                 x.sizes());
  return call(matrix, x.to(matrix.values.scalar_type()));
}

}  // namespace freetalk::nn
