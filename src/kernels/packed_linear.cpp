#include "kernels/packed_linear.h"

#include <ATen/ATen.h>
#include <ATen/Version.h>
#include <ATen/core/dispatch/Dispatcher.h>

#include <optional>

namespace freetalk::kernels {
namespace {

/// One of the operators that torch.compile uses for oneDNN; called boxed, since their C++
/// signatures differ between versions of torch.
at::Tensor call(const char* name, const char* overload, torch::jit::Stack stack) {
  c10::Dispatcher::singleton().findSchemaOrThrow(name, overload).callBoxed(stack);
  return stack.front().toTensor();
}

bool packs(const at::Tensor& weight) {
  if (!weight.is_cpu() || !at::globalContext().userEnabledMkldnn()) return false;
  const std::string capability = at::get_cpu_capability();
  const bool fits = weight.scalar_type() == at::kFloat
                        ? capability == "AVX512" || capability == "AVX2"
                        : weight.scalar_type() == at::kBFloat16 && capability == "AVX512";
  auto& dispatcher = c10::Dispatcher::singleton();
  return fits && dispatcher.findSchema({"mkldnn::_reorder_linear_weight", ""}) &&
         dispatcher.findSchema({"mkldnn::_linear_pointwise", ""}) &&
         dispatcher.findSchema({"mkldnn::_linear_pointwise", "binary"});
}

}  // namespace

PackedLinear::PackedLinear(const at::Tensor& weight, const at::Tensor& bias, at::ScalarType dtype,
                           int64_t rows)
    : weight_(weight.detach().to(dtype).contiguous()), bias_(bias.detach().to(dtype).contiguous()) {
  if (!packs(weight_)) return;
  packed_ = call("mkldnn::_reorder_linear_weight", "", {weight_, rows});
  weight_ = at::Tensor();
}

at::Tensor PackedLinear::operator()(const at::Tensor& x, const std::string& activation) const {
  if (packed_.defined()) {
    const std::string variant = activation == "gelu" ? "none" : "";  // gelu by erf, not by tanh
    return call("mkldnn::_linear_pointwise", "",
                {x, packed_, bias_, activation, c10::List<std::optional<at::Scalar>>(), variant});
  }
  const at::Tensor product = at::linear(x, weight_, bias_);
  if (activation == "gelu") return at::gelu(product);
  return activation == "relu" ? at::relu(product) : product;
}

at::Tensor PackedLinear::add(const at::Tensor& x, const at::Tensor& residual) const {
  if (!packed_.defined()) return at::linear(x, weight_, bias_).add_(residual);
  return call("mkldnn::_linear_pointwise", "binary", {x, residual, packed_, bias_, "add"});
}

}  // namespace freetalk::kernels
