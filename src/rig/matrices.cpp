#include "matrices.h"

#include <ATen/ATen.h>

#include "core/parallel.h"

namespace freetalk::rig {

Rows landmark_rows(const at::Tensor& landmarks) { return 1e3 * to_rows(landmarks.flatten(1)); }

Rows to_rows(const at::Tensor& matrix) {
  const at::Tensor wide = matrix.to(at::kCPU, at::kDouble).contiguous();
  return Eigen::Map<const Rows>(wide.const_data_ptr<double>(), wide.size(0), wide.size(1));
}

at::Tensor to_tensor(const Rows& rows) {
  return at::from_blob(const_cast<double*>(rows.data()), {rows.rows(), rows.cols()}, at::kDouble)
      .clone();
}

Rows products(const at::Tensor& a, const at::Tensor& b) {
  using Field = Eigen::Map<const Eigen::VectorXf>;
  const int64_t length = a.numel() / a.size(0);
  Rows result(a.size(0), b.size(0));
  core::parallel_for(0, a.size(0), 1, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      const Eigen::VectorXd left =
          Field(a.const_data_ptr<float>() + i * length, length).cast<double>();
      for (int64_t j = 0; j < b.size(0); ++j) {
        const Field right(b.const_data_ptr<float>() + j * length, length);
        result(i, j) = left.dot(right.cast<double>());
      }
    }
  });
  return result;
}

}  // namespace freetalk::rig
