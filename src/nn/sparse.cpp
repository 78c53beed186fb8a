#include "freetalk/nn/sparse.h"

#include <torch/csrc/autograd/custom_function.h>
#include <torch/torch.h>

#include <algorithm>

#include "core/parallel.h"
#include "freetalk/core/error.h"
#include "kernels/sparse_rows.h"

namespace freetalk::nn {
namespace {

template <class T>
void cpu_product(const at::Tensor& matrix, const at::Tensor& x, at::Tensor& y) {
  const at::Tensor rows = matrix.crow_indices().to(at::kLong).contiguous();
  const at::Tensor columns = matrix.col_indices().to(at::kLong).contiguous();
  const at::Tensor values = matrix.values().contiguous();
  const int64_t num_rows = matrix.size(0), channels = x.size(2), vertices = x.size(1);
  const kernels::SparseRows<T, int64_t> view{rows.const_data_ptr<int64_t>(),
                                             columns.const_data_ptr<int64_t>(),
                                             values.const_data_ptr<T>()};
  const T* x_data = x.const_data_ptr<T>();
  T* y_data = y.data_ptr<T>();
  core::parallel_for(0, x.size(0) * num_rows, 512, [&](int64_t begin, int64_t end) {
    for (int64_t index = begin; index < end;) {  // a stretch of rows of one batch at a time
      const int64_t batch = index / num_rows, row = index % num_rows;
      const int64_t count = std::min(end - index, num_rows - row);
      kernels::multiply_rows(view, row, row + count, x_data + batch * vertices * channels, channels,
                             y_data + index * channels);
      index += count;
    }
  });
}

at::Tensor product(const at::Tensor& matrix, const at::Tensor& x) {
  const bool direct =
      x.is_cpu() && (x.scalar_type() == at::kFloat || x.scalar_type() == at::kDouble);
  if (direct) {
    at::Tensor y = at::empty({x.size(0), matrix.size(0), x.size(2)}, x.options());
    const at::Tensor dense = x.contiguous();
    if (x.scalar_type() == at::kFloat) {
      cpu_product<float>(matrix, dense, y);
    } else {
      cpu_product<double>(matrix, dense, y);
    }
    return y;
  }
  const at::Tensor flat = x.transpose(0, 1).reshape({x.size(1), -1});  // (V, B C)
  return matrix.matmul(flat).view({matrix.size(0), x.size(0), x.size(2)}).transpose(0, 1);
}

class SparseProduct : public torch::autograd::Function<SparseProduct> {
 public:
  static at::Tensor forward(torch::autograd::AutogradContext* context, const at::Tensor& matrix,
                            const at::Tensor& transposed, const at::Tensor& x) {
    context->save_for_backward({matrix, transposed});
    return product(matrix, x);
  }
  static torch::autograd::tensor_list backward(torch::autograd::AutogradContext* context,
                                               torch::autograd::tensor_list gradients) {
    const auto saved = context->get_saved_variables();
    return {at::Tensor(), at::Tensor(), SparseProduct::apply(saved[1], saved[0], gradients[0])};
  }
};

}  // namespace

at::Tensor sparse_product(const at::Tensor& matrix, const at::Tensor& transposed,
                          const at::Tensor& x) {
  FREETALK_CHECK(x.dim() == 3 && x.size(1) == matrix.size(1), "sparse_product: expected x (B, ",
                 matrix.size(1), ", C), found ", x.sizes());
  return SparseProduct::apply(matrix, transposed, x.to(matrix.scalar_type()));
}

}  // namespace freetalk::nn
