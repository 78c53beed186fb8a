#include "freetalk/nn/sparse.h"

#include <torch/csrc/autograd/custom_function.h>
#include <torch/torch.h>

#include "core/parallel.h"
#include "freetalk/core/error.h"

namespace freetalk::nn {
namespace {

#define FREETALK_CLONES __attribute__((target_clones("avx512f", "avx2", "default")))

// One row of A times x: y = sum_j value_j x[column_j], C channels each.
FREETALK_CLONES void row_product(const float* values, const int64_t* columns, int64_t count,
                                 const float* x, int64_t channels, float* y) {
  for (int64_t c = 0; c < channels; ++c) y[c] = 0;
  for (int64_t entry = 0; entry < count; ++entry) {
    const float value = values[entry];
    const float* source = x + columns[entry] * channels;
    for (int64_t c = 0; c < channels; ++c) y[c] += value * source[c];
  }
}

FREETALK_CLONES void row_product(const double* values, const int64_t* columns, int64_t count,
                                 const double* x, int64_t channels, double* y) {
  for (int64_t c = 0; c < channels; ++c) y[c] = 0;
  for (int64_t entry = 0; entry < count; ++entry) {
    const double value = values[entry];
    const double* source = x + columns[entry] * channels;
    for (int64_t c = 0; c < channels; ++c) y[c] += value * source[c];
  }
}

template <class T>
void cpu_product(const at::Tensor& matrix, const at::Tensor& x, at::Tensor& y) {
  const at::Tensor rows = matrix.crow_indices().to(at::kLong).contiguous();
  const at::Tensor columns = matrix.col_indices().to(at::kLong).contiguous();
  const at::Tensor values = matrix.values().contiguous();
  const int64_t num_rows = matrix.size(0), channels = x.size(2), vertices = x.size(1);
  const int64_t* row_data = rows.const_data_ptr<int64_t>();
  const int64_t* column_data = columns.const_data_ptr<int64_t>();
  const T* value_data = values.const_data_ptr<T>();
  const T* x_data = x.const_data_ptr<T>();
  T* y_data = y.data_ptr<T>();
  core::parallel_for(0, x.size(0) * num_rows, 512, [&](int64_t begin, int64_t end) {
    for (int64_t index = begin; index < end; ++index) {
      const int64_t row = index % num_rows, first = row_data[row];
      row_product(value_data + first, column_data + first, row_data[row + 1] - first,
                  x_data + index / num_rows * vertices * channels, channels,
                  y_data + index * channels);
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
