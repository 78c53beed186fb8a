#include "freetalk/nn/ensembled_linear.h"

#include <torch/torch.h>

#include <cmath>

#include "freetalk/core/error.h"

namespace freetalk::nn {
namespace {

using torch::autograd::AutogradContext;
using torch::autograd::tensor_list;

at::Tensor grouped_outer(const at::Tensor& y, const at::Tensor& x,
                         const std::vector<int64_t>& first);

/// Calls body(group, first row, number of rows) for groups that have rows.
template <class Body>
void for_each_group(const std::vector<int64_t>& first, const Body& body) {
  for (size_t group = 0; group + 1 < first.size(); ++group) {
    const int64_t rows = first[group + 1] - first[group];
    if (rows > 0) body(static_cast<int64_t>(group), first[group], rows);
  }
}

class GroupedProduct : public torch::autograd::Function<GroupedProduct> {
 public:
  static at::Tensor forward(AutogradContext* context, const at::Tensor& x, const at::Tensor& weight,
                            const std::vector<int64_t>& first) {
    context->save_for_backward({x, weight});
    context->saved_data["first"] = first;
    at::Tensor y = at::empty({x.size(0), weight.size(1)}, x.options());
    for_each_group(first, [&](int64_t group, int64_t row, int64_t rows) {
      at::Tensor part = y.narrow(0, row, rows);
      at::mm_out(part, x.narrow(0, row, rows), weight[group].t());
    });
    return y;
  }
  static tensor_list backward(AutogradContext* context, const tensor_list& gradients) {
    const auto saved = context->get_saved_variables();
    const auto first = context->saved_data["first"].toIntVector();
    tensor_list result(3);
    if (context->needs_input_grad(0)) {
      result[0] = grouped_product(gradients[0], saved[1].transpose(1, 2), first);
    }
    if (context->needs_input_grad(1)) result[1] = grouped_outer(gradients[0], saved[0], first);
    return result;
  }
};

/// (G, out, in), the sums of outer products y_r x_r^T over the rows of each group.
class GroupedOuter : public torch::autograd::Function<GroupedOuter> {
 public:
  static at::Tensor forward(AutogradContext* context, const at::Tensor& y, const at::Tensor& x,
                            const std::vector<int64_t>& first) {
    context->save_for_backward({y, x});
    context->saved_data["first"] = first;
    const auto groups = static_cast<int64_t>(first.size()) - 1;
    at::Tensor sums = at::zeros({groups, y.size(1), x.size(1)}, x.options());
    for_each_group(first, [&](int64_t group, int64_t row, int64_t rows) {
      at::Tensor part = sums[group];
      at::mm_out(part, y.narrow(0, row, rows).t(), x.narrow(0, row, rows));
    });
    return sums;
  }
  static tensor_list backward(AutogradContext* context, const tensor_list& gradients) {
    const auto saved = context->get_saved_variables();
    const auto first = context->saved_data["first"].toIntVector();
    tensor_list result(3);
    if (context->needs_input_grad(0)) result[0] = grouped_product(saved[1], gradients[0], first);
    if (context->needs_input_grad(1)) {
      result[1] = grouped_product(saved[0], gradients[0].transpose(1, 2), first);
    }
    return result;
  }
};

at::Tensor grouped_outer(const at::Tensor& y, const at::Tensor& x,
                         const std::vector<int64_t>& first) {
  return GroupedOuter::apply(y, x, first);
}

}  // namespace

at::Tensor grouped_product(const at::Tensor& x, const at::Tensor& weight,
                           const std::vector<int64_t>& first) {
  FREETALK_CHECK(x.dim() == 2 && weight.dim() == 3 && x.size(1) == weight.size(2),
                 "grouped_product: expected x (R, in) and weight (G, out, in), found ", x.sizes(),
                 " and ", weight.sizes());
  FREETALK_CHECK(static_cast<int64_t>(first.size()) == weight.size(0) + 1 && first.front() == 0 &&
                     first.back() == x.size(0),
                 "grouped_product: first must hold ", weight.size(0) + 1, " rows from 0 to ",
                 x.size(0));
  return GroupedProduct::apply(x, weight, first);
}

std::vector<int64_t> networks_of_members(int64_t num_members, int64_t num_pairs) {
  std::vector<int64_t> networks;
  for (int64_t member = 0; member < num_members; ++member) {
    networks.push_back(member < 2 * num_pairs ? member / 2 : member - num_pairs);
  }
  return networks;
}

EnsembledLinearImpl::EnsembledLinearImpl(int64_t num_members, int64_t num_pairs,
                                         int64_t in_channels, int64_t out_channels)
    : num_members_(num_members), num_pairs_(num_pairs) {
  FREETALK_CHECK(num_pairs >= 0 && 2 * num_pairs <= num_members,
                 "EnsembledLinear: 2 num_pairs = ", 2 * num_pairs,
                 " exceed num_members = ", num_members);
  const int64_t networks = num_members - num_pairs;
  const double bound = 1 / std::sqrt(static_cast<double>(in_channels));  // as of torch's linear
  weight = register_parameter(
      "weight", torch::empty({networks, out_channels, in_channels}).uniform_(-bound, bound));
  bias = register_parameter("bias", torch::empty({networks, out_channels}).uniform_(-bound, bound));
}

at::Tensor EnsembledLinearImpl::forward(const at::Tensor& x) {
  FREETALK_CHECK(x.dim() == 3 && x.size(0) == num_members_ && x.size(2) == weight.size(2),
                 "EnsembledLinear: expected x (", num_members_, ", N, ", weight.size(2),
                 "), found ", x.sizes());
  const at::Tensor network =
      at::tensor(networks_of_members(num_members_, num_pairs_), at::kLong).to(x.device());
  return at::baddbmm(bias.index_select(0, network).unsqueeze(1), x,
                     weight.index_select(0, network).transpose(1, 2));
}

}  // namespace freetalk::nn
