#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cmath>

#include "freetalk/geometry/operators.h"
#include "freetalk/nn/diffusion_net.h"
#include "freetalk/nn/embedding.h"
#include "freetalk/nn/sparse.h"
#include "freetalk/nn/transformer.h"
#include "nn/local_start.h"

namespace freetalk::nn {
namespace {

at::Tensor random_sparse(int64_t rows, int64_t columns) {
  const at::Tensor dense = torch::randn({rows, columns}, torch::kDouble);
  return dense * (torch::rand({rows, columns}) < 0.3);
}

geometry::SurfaceOperators grid_operators(int64_t k) {
  constexpr int kSide = 6;
  Eigen::MatrixXd vertices(kSide * kSide, 3);
  std::vector<std::array<int, 3>> triangles;
  for (int i = 0; i < kSide; ++i) {
    for (int j = 0; j < kSide; ++j) {
      vertices.row(i * kSide + j) << 0.3 * i, 0.2 * j, 0.05 * std::sin(i + j);
      if (i + 1 < kSide && j + 1 < kSide) {
        const int a = i * kSide + j, b = a + 1, c = a + kSide, d = c + 1;
        triangles.push_back({a, c, b});
        triangles.push_back({b, c, d});
      }
    }
  }
  Eigen::MatrixXi faces(static_cast<int>(triangles.size()), 3);
  for (size_t f = 0; f < triangles.size(); ++f) {
    for (int c = 0; c < 3; ++c)
      faces(static_cast<int>(f), c) = triangles[f][static_cast<size_t>(c)];
  }
  geometry::OperatorOptions options;
  options.k_eig = k;
  return geometry::surface_operators(vertices, faces, options);
}

DiffusionNetOptions small_options(int64_t blocks) {
  DiffusionNetOptions options;
  options.in_channels = 3;
  options.out_channels = 2;
  options.width = 8;
  options.num_blocks = blocks;
  return options;
}

geometry::SparseOperator operator_of(const at::Tensor& dense, at::ScalarType index) {
  const at::Tensor csr = dense.to_sparse_csr();
  return geometry::SparseOperator::from_rows(
      csr.crow_indices().to(index), csr.col_indices().to(index), csr.values(), dense.size(1));
}

TEST(SparseProduct, EqualsDenseWithGradientForEveryIndexAndValueType) {
  torch::manual_seed(0);
  for (const auto index : {at::kInt, at::kLong}) {
    for (const auto type : {at::kFloat, at::kDouble}) {
      const double tolerance = type == at::kFloat ? 1e-5 : 1e-12;  // of sums of a few terms near 1
      const at::Tensor dense = random_sparse(700, 5).to(type);  // more rows than one thread takes
      at::Tensor x = torch::randn({3, 5, 4}, torch::dtype(type).requires_grad(true));
      at::Tensor x_copy = x.detach().clone().requires_grad_(true);
      const at::Tensor y = sparse_product(operator_of(dense, index), x);
      const at::Tensor expected = dense.matmul(x_copy);
      EXPECT_TRUE(torch::allclose(y, expected, tolerance, tolerance));
      const at::Tensor weight = torch::randn_like(y);
      (y * weight).sum().backward();
      (expected * weight).sum().backward();
      EXPECT_TRUE(torch::allclose(x.grad(), x_copy.grad(), 10 * tolerance, 10 * tolerance));
    }
  }
}

TEST(SparseProduct, WrongSizeIsNamed) {
  EXPECT_THROW(sparse_product(operator_of(random_sparse(4, 5), at::kInt), torch::zeros({1, 4, 2})),
               std::invalid_argument);
}

TEST(SparseProduct, MatrixThatWantsAGradientIsRefused) {
  geometry::SparseOperator matrix = operator_of(random_sparse(4, 5), at::kInt);
  matrix.values.requires_grad_(true);
  EXPECT_THROW(sparse_product(matrix, torch::zeros({1, 5, 2}, torch::kDouble)),
               std::invalid_argument);
}

TEST(SinusoidalCode, IsTheClosedForm) {
  const at::Tensor code = sinusoidal_code(torch::tensor({0, 3}), 4);
  const float expected[] = {
      0, 0, 1, 1, std::sin(3.0F), std::sin(0.03F), std::cos(3.0F), std::cos(0.03F)};
  for (int i = 0; i < 8; ++i) EXPECT_NEAR(code.view(-1)[i].item<float>(), expected[i], 1e-6);
}

TEST(BandMask, AllowsOnlyTheBand) {
  const at::Tensor mask = band_mask(5, 1, c10::kCPU);
  for (int i = 0; i < 5; ++i) {
    for (int j = 0; j < 5; ++j) EXPECT_EQ(mask[i][j].item<bool>(), std::abs(i - j) <= 1);
  }
}

// Over a middle frame: the share of each head's weight near its distance, and the mean distance.
TEST(MultiheadAttention, StartsAtDistancesSpacedOverTheBand) {
  constexpr int64_t kFrames = 61, kWidth = 64, kHeads = 4;
  torch::manual_seed(0);
  MultiheadAttention attention(kWidth, kHeads, 0.0);
  start_locally(attention, 3.0);
  const at::Tensor code = local_position_code(kFrames, kWidth, kHeads);
  const auto heads = [&](int64_t part) {
    const at::Tensor rows = attention->in_proj_weight.narrow(0, part * kWidth, kWidth);
    return code.matmul(rows.t()).view({kFrames, kHeads, -1}).transpose(0, 1);  // (heads, T, d_head)
  };
  const at::Tensor logits = heads(0).matmul(heads(1).transpose(1, 2)) / std::sqrt(kWidth / kHeads);
  const at::Tensor outside = band_mask(kFrames, 3, at::kCPU).logical_not();
  const at::Tensor weights =
      at::softmax(logits.masked_fill(outside, -INFINITY), 2).select(1, kFrames / 2);  // (heads, T)
  const at::Tensor distance = at::arange(kFrames) - kFrames / 2;
  double before = -INFINITY;
  for (int64_t head = 0; head < kHeads; ++head) {
    const double wanted = 1.5 * ((2.0 * static_cast<double>(head) + 1) / kHeads - 1);
    const at::Tensor near = (distance - wanted).abs() <= 1.5;
    EXPECT_GT(weights[head].masked_select(near).sum().item<double>(), 0.8) << "head " << head;
    const double mean = (weights[head] * distance).sum().item<double>();
    EXPECT_NEAR(mean, wanted, 0.4);
    EXPECT_GT(mean, before + 0.3);  // one after the other
    before = mean;
  }
}

TEST(MultiheadAttention, MaskedKeysHaveNoInfluence) {
  torch::manual_seed(1);
  MultiheadAttention attention(8, 2, 0.0);
  const at::Tensor query = torch::randn({1, 3, 8});
  at::Tensor memory = torch::randn({1, 3, 8});
  const at::Tensor allowed = band_mask(3, 0, c10::kCPU);
  const at::Tensor before = attention(query, memory, allowed);
  memory = memory.clone();
  memory[0][2] += 100;
  const at::Tensor after = attention(query, memory, allowed);
  EXPECT_TRUE(torch::equal(before.narrow(1, 0, 2), after.narrow(1, 0, 2)));
  EXPECT_FALSE(torch::allclose(before[0][2], after[0][2]));
}

TEST(DiffusionNet, ConstantsDiffuseToThemselves) {
  const auto operators = grid_operators(8);
  LearnedDiffusion diffusion(2);
  diffusion->to(torch::kDouble);
  const at::Tensor x = torch::ones({1, 36, 2}, torch::kDouble);
  EXPECT_TRUE(torch::allclose(diffusion(x, operators), x, 1e-6, 1e-6));
}

TEST(DiffusionNet, FramesAreIndependent) {
  torch::manual_seed(2);
  const auto operators = grid_operators(8);
  DiffusionNet net(small_options(2));
  net->to(torch::kDouble);
  const at::Tensor x = torch::randn({4, 36, 3}, torch::kDouble);
  const at::Tensor all = net(x, operators);
  for (int64_t frame = 0; frame < 4; ++frame) {
    EXPECT_TRUE(torch::allclose(all.narrow(0, frame, 1), net(x.narrow(0, frame, 1), operators),
                                1e-9, 1e-9));
  }
}

TEST(DiffusionNet, WrongShapeThrows) {
  const auto operators = grid_operators(8);
  DiffusionNet net(small_options(1));
  EXPECT_THROW(net(torch::zeros({1, 35, 3}), operators), std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::nn
