#include "nn/fused_diffusion.h"

#include <ATen/Parallel.h>
#include <gtest/gtest.h>
#include <torch/torch.h>

#include <string>

#include "../mesh/shapes.h"
#include "freetalk/geometry/operators.h"
#include "kernels/isa.h"

namespace freetalk::nn {
namespace {

constexpr int64_t kFrames = 5, kWidth = 24, kKeys = 11;

/// A head with 258 vertices, a network that moves it, and inputs with two heads of attention.
struct Scene {
  geometry::SurfaceOperators operators;
  DiffusionNet net{nullptr};
  at::Tensor base, queries, mixing;
  FrameInputs inputs;

  Scene() {
    torch::manual_seed(3);
    const testing::Shape head = testing::toy_head(3);
    geometry::OperatorOptions of_mesh;
    of_mesh.k_eig = 20;
    operators = geometry::surface_operators(head.vertices, head.faces, of_mesh).to(at::kFloat);
    DiffusionNetOptions options;
    options.in_channels = 4;
    options.out_channels = 3;
    options.width = kWidth;
    options.num_blocks = 2;
    net = DiffusionNet(options);
    net->eval();
    const torch::NoGradGuard no_grad;
    for (auto& named : net->named_parameters()) {
      if (named.key().find("diffusion_time") != std::string::npos) named.value().uniform_(0, 0.02);
    }
    const int64_t vertices = head.vertices.rows();
    base = torch::randn({vertices, kWidth});
    queries = torch::randn({2, vertices, 8});
    inputs.offsets = torch::randn({kFrames, kWidth});
    inputs.keys = 0.3 * torch::randn({kFrames, 2, kKeys, 8});
    inputs.values = torch::randn({kFrames, 2, kKeys, 6});
    mixing = torch::randn({kWidth, 12});
  }

  at::Tensor expected() {
    const torch::NoGradGuard no_grad;
    const at::Tensor shares = at::softmax(at::matmul(queries, inputs.keys.transpose(-1, -2)), -1);
    const at::Tensor attended = at::matmul(shares, inputs.values)  // (T, heads, V, 6)
                                    .transpose(1, 2)
                                    .flatten(2)
                                    .matmul(mixing.t());
    return net->forward_hidden(base + inputs.offsets.unsqueeze(1) + attended, operators);
  }

  at::Tensor fused(bool bfloat16, int64_t in_work = 8) {
    const FusedDiffusion decoder(*net, operators, {base, queries, mixing}, bfloat16);
    return decoder.run(inputs, kFrames, in_work);
  }
};

double relative(const at::Tensor& result, const at::Tensor& expected) {
  return ((result - expected).norm() / expected.norm()).item<double>();
}

TEST(FusedDiffusion, IsTheNetworkAtEveryInstructionSet) {
  Scene scene;
  const at::Tensor expected = scene.expected();
  for (int level = 0; level <= static_cast<int>(kernels::best_isa()); ++level) {
    const kernels::IsaScope scope(static_cast<kernels::Isa>(level));
    // Sums of up to 258 products in float32.
    EXPECT_LT(relative(scene.fused(false), expected), 1e-5) << level;
    if (FusedDiffusion::supports_bfloat16()) {
      EXPECT_EQ(kernels::isa(), kernels::Isa::avx512_bf16);
      EXPECT_LT(relative(scene.fused(true), expected), 0.02);  // 8 bits through two blocks
    }
  }
}

TEST(FusedDiffusion, HasTheSameBitsForAnyNumberOfThreadsAndFramesInWork) {
  Scene scene;
  const int before = at::get_num_threads();
  for (const bool bfloat16 : {false, true}) {
    at::set_num_threads(1);
    const at::Tensor alone = scene.fused(bfloat16, 1);
    for (const int threads : {2, 5}) {
      at::set_num_threads(threads);
      EXPECT_TRUE(at::equal(scene.fused(bfloat16, 8), alone));
      EXPECT_TRUE(at::equal(scene.fused(bfloat16, 2), alone));
    }
  }
  at::set_num_threads(before);
}

TEST(FusedDiffusion, WorkSpacesOfARunServeAnotherWithOtherInputs) {
  Scene scene;
  const FusedDiffusion decoder(*scene.net, scene.operators,
                               {scene.base, scene.queries, scene.mixing}, false);
  const at::Tensor first = decoder.run(scene.inputs, kFrames, 8);
  FrameInputs fewer = scene.inputs;
  fewer.keys = scene.inputs.keys.narrow(2, 0, 3).contiguous();
  fewer.values = scene.inputs.values.narrow(2, 0, 3).contiguous();
  const at::Tensor second = decoder.run(fewer, kFrames, 8);
  scene.inputs = fewer;
  EXPECT_LT(relative(second, scene.expected()), 1e-5);
  EXPECT_GT(relative(second, first), 1e-3);
}

}  // namespace
}  // namespace freetalk::nn
