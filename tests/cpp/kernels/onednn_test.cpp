#include "kernels/onednn.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <string>

namespace freetalk::kernels {
namespace {

at::Tensor activated(const at::Tensor& x, const std::string& name) {
  if (name == "gelu") return at::gelu(x);
  if (name == "relu") return at::relu(x);
  return name == "silu" ? at::silu(x) : x;
}

double largest(const at::Tensor& x) { return x.to(at::kDouble).abs().max().item<double>(); }

// Sums of 48 products of about one: float32 is right to 1e-5, and bfloat16 rounds a result of up to
// 30, and the terms of a sum with a residual, to 8 bits.
double tolerance(at::ScalarType dtype) { return dtype == at::kFloat ? 1e-4 : 0.3; }

TEST(FixedLinear, IsTheLinearLayerPackedOrNot) {
  at::manual_seed(0);
  for (const auto dtype : {at::kFloat, at::kBFloat16}) {
    const at::Tensor weight = at::randn({32, 48}), bias = at::randn({32});
    const at::Tensor x = at::randn({3, 5, 48}).to(dtype),
                     residual = at::randn({3, 5, 32}).to(dtype);
    const at::Tensor product = at::linear(x.to(at::kFloat), weight.to(dtype).to(at::kFloat),
                                          bias.to(dtype).to(at::kFloat));
    for (const int64_t rows : {0, 15}) {
      const FixedLinear layer(weight, bias, dtype, rows);
      for (const std::string name : {"", "gelu", "relu", "silu"}) {
        EXPECT_LT(largest(layer(x, name) - activated(product, name)), tolerance(dtype))
            << name << ", rows " << rows;
      }
      EXPECT_LT(largest(layer.add(x, residual) - (residual.to(at::kFloat) + product)),
                tolerance(dtype));
    }
  }
}

TEST(FixedLinear, SharesWeightsThatItNeedNotChange) {
  at::Tensor weight = at::randn({16, 16});
  const at::Tensor x = at::randn({4, 16}), bias = at::zeros({16});
  const FixedLinear layer(weight, bias, at::kFloat);
  weight.zero_();
  EXPECT_EQ(largest(layer(x)), 0.0);
}

TEST(FixedConv, IsTheGroupedConvolution) {
  if (!has_onednn(at::kFloat)) GTEST_SKIP() << "LibTorch is built without oneDNN";
  at::manual_seed(1);
  const at::Tensor weight = at::randn({32, 8, 5}), bias = at::randn({32}), x = at::randn({70, 16});
  for (const int64_t stride : {1, 2}) {
    const FixedConv layer(weight, bias, {stride, 2, 2}, at::kFloat);
    const at::Tensor expected =
        at::gelu(at::conv1d(x.t().unsqueeze(0), weight, bias, stride, 2, 1, 2)).squeeze(0).t();
    const at::Tensor result = layer(x, "gelu");
    ASSERT_EQ(result.sizes(), expected.sizes());
    EXPECT_LT(largest(result - expected), tolerance(at::kFloat));
  }
}

}  // namespace
}  // namespace freetalk::kernels
