#include "kernels/onednn.h"

#include <ATen/ATen.h>
#include <ATen/Version.h>
#include <ATen/core/dispatch/Dispatcher.h>

#include <utility>
#include <vector>

namespace freetalk::kernels {
namespace {

using Scalars = c10::List<std::optional<at::Scalar>>;

/// The operators that torch.compile uses for oneDNN, which LibTorch's headers do not declare;
/// called boxed, since their C++ signatures differ between versions of torch.
struct Operators {
  c10::OperatorHandle linear, linear_binary, pack_linear, convolution, pack_convolution;
};

/// Nothing where LibTorch is built without oneDNN.
const std::optional<Operators>& operators() {
  static const auto found = []() -> std::optional<Operators> {
    const auto find = [](const char* name, const char* overload) {
      return c10::Dispatcher::singleton().findSchema({name, overload});
    };
    const auto linear = find("mkldnn::_linear_pointwise", "");
    const auto linear_binary = find("mkldnn::_linear_pointwise", "binary");
    const auto pack_linear = find("mkldnn::_reorder_linear_weight", "");
    const auto convolution = find("mkldnn::_convolution_pointwise", "");
    const auto pack_convolution = find("mkldnn::_reorder_convolution_weight", "");
    if (!linear || !linear_binary || !pack_linear || !convolution || !pack_convolution) {
      return std::nullopt;
    }
    return Operators{*linear, *linear_binary, *pack_linear, *convolution, *pack_convolution};
  }();
  return found;
}

template <class... Arguments>
at::Tensor call(const c10::OperatorHandle& handle, Arguments&&... arguments) {
  torch::jit::Stack stack;
  stack.reserve(sizeof...(arguments));
  (stack.emplace_back(std::forward<Arguments>(arguments)), ...);
  handle.callBoxed(&stack);
  return stack.front().toTensor();
}

/// oneDNN's word for an activation.
std::string kernel_name(const std::string& activation) {
  return activation.empty() ? "none" : activation == "silu" ? "swish" : activation;
}

bool probe(at::ScalarType dtype) {
  if (!operators()) return false;
  try {  // a processor may lack the instructions for half precision
    const auto x = at::ones({2, 16}, dtype);
    const auto y = onednn_linear(x, at::ones({16, 16}, dtype), std::nullopt);
    return y.eq(16.0).all().item<bool>();
  } catch (const c10::Error&) {
    return false;
  }
}

/// Whether a layout of the weights is faster than none.
bool worth_packing(at::ScalarType dtype) {
  const std::string capability = at::get_cpu_capability();
  return capability == "AVX512" || (dtype == at::kFloat && capability == "AVX2");
}

/// (L, C) contiguous as a picture (1, C, 1, L), channels last.
at::Tensor as_picture(const at::Tensor& x) {
  const int64_t length = x.size(0), width = x.size(1);
  return x.as_strided({1, width, 1, length}, {width * length, 1, width * length, width});
}

}  // namespace

bool has_onednn(at::ScalarType dtype) {
  if (!at::globalContext().userEnabledMkldnn()) return false;
  if (dtype == at::kFloat) {
    static const bool found = probe(at::kFloat);
    return found;
  }
  static const bool found = probe(at::kBFloat16);
  return dtype == at::kBFloat16 && found;
}

at::Tensor onednn_linear(const at::Tensor& x, const at::Tensor& weight,
                         const std::optional<at::Tensor>& bias, const std::string& activation) {
  return call(operators()->linear, x, weight, c10::IValue(bias), kernel_name(activation),
              c10::IValue(Scalars()), std::string("none"));
}

FixedLinear::FixedLinear(const at::Tensor& weight, const at::Tensor& bias, at::ScalarType dtype,
                         int64_t rows)
    : weight_(weight.detach().to(dtype)), bias_(bias.detach().to(dtype)) {
  const bool pack = rows > 0 && worth_packing(dtype);
  fused_ = weight.is_cpu() && (rows == 0 || pack) && has_onednn(dtype);
  if (!fused_ || !pack) return;
  bias_ = bias_.contiguous();
  weight_ = call(operators()->pack_linear, weight_.contiguous(), rows);
}

at::Tensor FixedLinear::operator()(const at::Tensor& x, const std::string& activation) const {
  if (fused_) return onednn_linear(x, weight_, bias_, activation);
  const at::Tensor product = at::linear(x, weight_, bias_);
  return activation == "gelu"   ? at::gelu(product)
         : activation == "relu" ? at::relu(product)
         : activation == "silu" ? at::silu(product)
                                : product;
}

at::Tensor FixedLinear::add(const at::Tensor& x, const at::Tensor& residual) const {
  if (!fused_) return at::linear(x, weight_, bias_).add_(residual);
  return call(operators()->linear_binary, x, residual, weight_, bias_, std::string("add"));
}

FixedConv::FixedConv(const at::Tensor& weight, const at::Tensor& bias, Shape shape,
                     at::ScalarType dtype)
    : weight_(weight.detach().to(dtype)),
      bias_(bias.defined() ? bias.detach().to(dtype) : bias),
      shape_(shape) {
  const std::vector<int64_t> typical = {1, weight.size(1) * shape.groups, 1, 1024};
  const auto picture = weight_.unsqueeze(2).contiguous(at::MemoryFormat::ChannelsLast);
  weight_ = call(operators()->pack_convolution, picture, std::vector<int64_t>{0, shape.padding},
                 std::vector<int64_t>{1, shape.stride}, std::vector<int64_t>{1, 1}, shape.groups,
                 c10::IValue(typical));
}

at::Tensor FixedConv::operator()(const at::Tensor& x, const std::string& activation) const {
  const auto bias = bias_.defined() ? std::optional<at::Tensor>(bias_) : std::nullopt;
  const auto y =
      call(operators()->convolution, as_picture(x.contiguous()), weight_, c10::IValue(bias),
           std::vector<int64_t>{0, shape_.padding}, std::vector<int64_t>{1, shape_.stride},
           std::vector<int64_t>{1, 1}, shape_.groups, kernel_name(activation),
           c10::IValue(Scalars()), std::string("none"));
  return y.squeeze(2).squeeze(0).t().contiguous();
}

}  // namespace freetalk::kernels
