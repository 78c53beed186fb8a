#include "fused.h"

#include <ATen/core/dispatch/Dispatcher.h>
#include <torch/torch.h>

#include <utility>

namespace freetalk::speech {
namespace {

using Scalars = c10::List<std::optional<at::Scalar>>;

/// Operators of LibTorch that its C++ headers do not declare.
struct Kernels {
  c10::OperatorHandle linear, convolution, reorder;
};

/// Nothing where LibTorch is built without oneDNN.
const std::optional<Kernels>& kernels() {
  static const auto found = []() -> std::optional<Kernels> {
    const auto find = [](const char* name) {
      return c10::Dispatcher::singleton().findSchema({name, ""});
    };
    const auto linear = find("mkldnn::_linear_pointwise");
    const auto convolution = find("mkldnn::_convolution_pointwise");
    const auto reorder = find("mkldnn::_reorder_convolution_weight");
    if (!linear || !convolution || !reorder) {
      return std::nullopt;
    }
    return Kernels{*linear, *convolution, *reorder};
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

/// oneDNN's word for an activation, and its flavour (exact, not tanh).
std::string kernel_name(const std::string& activation) {
  return activation.empty() ? "none" : activation == "silu" ? "swish" : activation;
}

bool probe(at::ScalarType dtype) {
  if (!kernels()) {
    return false;
  }
  try {  // a processor may lack the instructions for half precision
    const auto x = at::ones({2, 16}, dtype);
    return fused_linear(x, at::ones({16, 16}, dtype), std::nullopt, "").eq(16.0).all().item<bool>();
  } catch (const c10::Error&) {
    return false;
  }
}

/// (L, C) contiguous as a picture (1, C, 1, L), channels last.
at::Tensor as_picture(const at::Tensor& x) {
  const int64_t length = x.size(0), width = x.size(1);
  return x.as_strided({1, width, 1, length}, {width * length, 1, width * length, width});
}

}  // namespace

at::Tensor fused_linear(const at::Tensor& x, const at::Tensor& weight,
                        const std::optional<at::Tensor>& bias, const std::string& activation) {
  return call(kernels()->linear, x, weight, c10::IValue(bias), kernel_name(activation),
              c10::IValue(Scalars()), std::string("none"));
}

bool has_fused_kernels(at::ScalarType dtype) {
  if (dtype == at::kFloat) {
    static const bool found = probe(at::kFloat);
    return found;
  }
  static const bool found = probe(at::kBFloat16);
  return dtype == at::kBFloat16 && found;
}

FusedLinear::FusedLinear(const at::Tensor& weight, const at::Tensor& bias, at::ScalarType dtype)
    : weight_(weight.detach().to(dtype)), bias_(bias.detach().to(dtype)) {}

at::Tensor FusedLinear::operator()(const at::Tensor& x, const std::string& activation) const {
  return fused_linear(x, weight_, bias_, activation);
}

FusedConv::FusedConv(const at::Tensor& weight, const at::Tensor& bias, Shape shape,
                     at::ScalarType dtype)
    : weight_(weight.detach().to(dtype)),
      bias_(bias.defined() ? bias.detach().to(dtype) : bias),
      shape_(shape) {
  const std::vector<int64_t> typical = {1, weight.size(1) * shape.groups, 1, 1024};
  const auto picture = weight_.unsqueeze(2).contiguous(at::MemoryFormat::ChannelsLast);
  weight_ = call(kernels()->reorder, picture, std::vector<int64_t>{0, shape.padding},
                 std::vector<int64_t>{1, shape.stride}, std::vector<int64_t>{1, 1}, shape.groups,
                 c10::IValue(typical));
}

at::Tensor FusedConv::operator()(const at::Tensor& x, const std::string& activation) const {
  const auto bias = bias_.defined() ? std::optional<at::Tensor>(bias_) : std::nullopt;
  const auto y =
      call(kernels()->convolution, as_picture(x.contiguous()), weight_, c10::IValue(bias),
           std::vector<int64_t>{0, shape_.padding}, std::vector<int64_t>{1, shape_.stride},
           std::vector<int64_t>{1, 1}, shape_.groups, kernel_name(activation),
           c10::IValue(Scalars()), std::string("none"));
  return y.squeeze(2).squeeze(0).t().contiguous();
}

}  // namespace freetalk::speech
