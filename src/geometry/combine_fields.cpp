#include "combine_fields.h"

#include <ATen/ATen.h>

#include "kernels/combine_rows.h"

namespace freetalk::geometry {

at::Tensor combine_fields(const GreedyInterpolation::Points& weights, const at::Tensor& fields) {
  const Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> single =
      weights.cast<float>();
  std::vector<int64_t> sizes = fields.sizes().vec();
  sizes.front() = single.rows();
  if (!fields.is_cpu()) {
    const at::Tensor factors = at::from_blob(const_cast<float*>(single.data()),
                                             {single.rows(), single.cols()}, at::kFloat);
    return at::mm(factors.to(fields.device()), fields.flatten(1)).view(sizes);
  }
  at::Tensor result = at::empty(sizes, fields.options());
  kernels::combine_rows(single.data(), single.rows(), single.cols(), fields.const_data_ptr<float>(),
                        fields.numel() / fields.size(0), result.data_ptr<float>());
  return result;
}

}  // namespace freetalk::geometry
