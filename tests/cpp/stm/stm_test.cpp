#include "freetalk/stm/stm.h"

#include <gtest/gtest.h>
#include <torch/torch.h>

#include <algorithm>
#include <numeric>
#include <random>
#include <set>

#include "freetalk/core/random.h"
#include "freetalk/stm/frame_decoder.h"
#include "freetalk/stm/landmark_graph.h"

namespace freetalk::stm {
namespace {

StmOptions small_options() {
  StmOptions options;
  options.encoder_width = options.decoder_width = options.feature_dim = 16;
  options.encoder_blocks = options.decoder_blocks = 2;
  options.gcn_hidden = options.index_code_dim = options.attention_dim = 16;
  options.attention_heads = 2;
  options.k_eig = 12;
  return options;
}

/// A half cylinder of 9 x 8 vertices, about the size of a face, its vertices permuted.
struct Sheet {
  Eigen::MatrixXd vertices{72, 3};
  Eigen::MatrixXi faces{112, 3};
  explicit Sheet(const std::vector<int>& order) {
    int face = 0;
    for (int i = 0; i < 9; ++i) {
      for (int j = 0; j < 8; ++j) {
        const double angle = 0.3 * (j - 3.5);
        vertices.row(order[static_cast<size_t>(8 * i + j)]) << 0.08 * std::sin(angle),
            0.02 * (i - 4), 0.08 * std::cos(angle);
        if (i < 8 && j < 7) {
          const auto at = [&](int a, int b) { return order[static_cast<size_t>(8 * a + b)]; };
          faces.row(face++) << at(i, j), at(i, j + 1), at(i + 1, j);
          faces.row(face++) << at(i, j + 1), at(i + 1, j + 1), at(i + 1, j);
        }
      }
    }
  }
};

struct Prepared {
  at::Tensor positions;
  geometry::SurfaceOperators operators;
};

Prepared prepare(const Sheet& sheet, const StmOptions& options) {
  geometry::OperatorOptions operator_options;
  operator_options.k_eig = options.k_eig;
  const auto operators = geometry::surface_operators(sheet.vertices / options.length_scale,
                                                     sheet.faces, operator_options);
  at::Tensor positions = torch::empty({72, 3}, torch::kDouble);
  for (int i = 0; i < 72; ++i) {
    for (int c = 0; c < 3; ++c) positions[i][c] = sheet.vertices(i, c);
  }
  return {positions.to(torch::kFloat), operators.to(torch::kFloat)};
}

std::vector<int> identity_order() {
  std::vector<int> order(72);
  std::iota(order.begin(), order.end(), 0);
  return order;
}

Stm model_with_motion() {
  torch::manual_seed(0);
  Stm model(small_options());
  const torch::NoGradGuard no_grad;
  for (auto& item : model->named_parameters()) {
    if (item.key() == "decoder.last_lin.weight") item.value().normal_(0, 0.3);
  }
  model->eval();
  return model;
}

at::Tensor random_landmarks(int64_t frames) {
  return 0.005 * torch::randn({frames, 68, 3}, core::make_generator(4));
}

TEST(Stm, UntrainedFaceStaysStill) {
  Stm model(small_options());
  const Prepared mesh = prepare(Sheet(identity_order()), model->options());
  EXPECT_EQ(model(mesh.positions, mesh.operators, random_landmarks(2)).abs().max().item<float>(),
            0.0F);
}

TEST(Stm, VertexOrderDoesNotMatter) {
  Stm model = model_with_motion();
  std::vector<int> order = identity_order();
  std::shuffle(order.begin(), order.end(), std::mt19937(3));
  const Prepared plain = prepare(Sheet(identity_order()), model->options());
  const Prepared shuffled = prepare(Sheet(order), model->options());
  const at::Tensor landmarks = random_landmarks(3);
  const at::Tensor a = model(plain.positions, plain.operators, landmarks);
  const at::Tensor b = model(shuffled.positions, shuffled.operators, landmarks);
  const at::Tensor index = torch::tensor(std::vector<int64_t>(order.begin(), order.end()));
  EXPECT_LT((a - b.index_select(1, index)).abs().max().item<float>(),
            2e-3F * a.abs().max().item<float>());
}

TEST(Stm, ChunksEqualTheWhole) {
  Stm model = model_with_motion();
  const Prepared mesh = prepare(Sheet(identity_order()), model->options());
  const at::Tensor landmarks = random_landmarks(11);
  const torch::NoGradGuard no_grad;
  const at::Tensor whole = model(mesh.positions, mesh.operators, landmarks);
  at::Tensor chunked = torch::full_like(whole, NAN);
  int64_t calls = 0;
  int64_t next = 0;
  decode_chunked(
      model, model->encode(mesh.positions, mesh.operators), mesh.operators, landmarks,
      [&](int64_t first, const at::Tensor& part) {
        EXPECT_EQ(first, next);
        next += part.size(0);
        chunked.narrow(0, first, part.size(0)).copy_(part);
        ++calls;
      },
      DecodeOptions{"float32", 1});
  EXPECT_EQ(next, 11);
  EXPECT_EQ(calls, 11);  // one frame in work takes more than a byte
  EXPECT_LT((whole - chunked).abs().max().item<float>(), 1e-5F * whole.abs().max().item<float>());
}

TEST(FrameDecoder, ServesSeveralSequencesOfOneMesh) {
  Stm model = model_with_motion();
  const Prepared mesh = prepare(Sheet(identity_order()), model->options());
  const torch::NoGradGuard no_grad;
  const auto features = model->encode(mesh.positions, mesh.operators);
  FrameDecoder decoder(model.ptr(), features, mesh.operators);
  for (const int64_t frames : {1, 5}) {
    const at::Tensor expected = model->decode(features, mesh.operators, random_landmarks(frames));
    const at::Tensor found = decoder.decode(random_landmarks(frames));
    EXPECT_LT((found - expected).abs().max().item<float>(),
              1e-5F * expected.abs().max().item<float>());
  }
}

TEST(FrameDecoder, UnknownPrecisionIsRefused) {
  Stm model = model_with_motion();
  const Prepared mesh = prepare(Sheet(identity_order()), model->options());
  const auto features = model->encode(mesh.positions, mesh.operators);
  EXPECT_THROW(FrameDecoder(model.ptr(), features, mesh.operators, DecodeOptions{"half", 1}),
               std::invalid_argument);
}

TEST(Stm, GradientsReachMeshAndLandmarkPaths) {
  Stm model = model_with_motion();
  const Prepared mesh = prepare(Sheet(identity_order()), model->options());
  at::Tensor landmarks = random_landmarks(2);
  landmarks.requires_grad_(true);
  const at::Tensor motion = model(mesh.positions, mesh.operators, landmarks);
  motion.square().sum().backward();
  for (const auto& item : model->named_parameters()) {
    if (item.key() == "encoder.last_lin.bias" || item.key() == "decoder.first_lin.weight") {
      EXPECT_GT(item.value().grad().abs().max().item<float>(), 0.0F) << item.key();
    }
  }
  EXPECT_GT(landmarks.grad().abs().max().item<float>(), 0.0F);
}

TEST(LandmarkGraph, IsSymmetricUnderMirrorAndConnected) {
  std::set<std::pair<int64_t, int64_t>> edges(landmark_edges().begin(), landmark_edges().end());
  for (const auto& [a, b] : edges) {
    const int64_t ma = landmark_mirror()[static_cast<size_t>(a)],
                  mb = landmark_mirror()[static_cast<size_t>(b)];
    EXPECT_EQ(edges.count({std::min(ma, mb), std::max(ma, mb)}), 1U) << a << "-" << b;
  }
  at::Tensor reach = (landmark_adjacency() > 0).to(torch::kFloat);
  for (int i = 0; i < 7; ++i) reach = reach.matmul(reach).clamp_max(1);
  EXPECT_TRUE((reach > 0).all().item<bool>());
}

TEST(Stm, WrongInputsAreNamed) {
  Stm model(small_options());
  const Prepared mesh = prepare(Sheet(identity_order()), model->options());
  EXPECT_THROW(model(mesh.positions.narrow(0, 0, 70), mesh.operators, random_landmarks(1)),
               std::invalid_argument);
  EXPECT_THROW(model(mesh.positions, mesh.operators, torch::zeros({1, 67, 3})),
               std::invalid_argument);
  StmOptions other = small_options();
  other.k_eig = 10;
  Stm other_model(other);
  EXPECT_THROW(other_model(mesh.positions, mesh.operators, random_landmarks(1)),
               std::invalid_argument);
}

TEST(Stm, NoErrorOfTorchComesThrough) {
  Stm model(small_options());
  const Prepared mesh = prepare(Sheet(identity_order()), model->options());
  const MeshFeatures features = model->encode(mesh.positions, mesh.operators);
  const at::Tensor doubles = random_landmarks(1).to(torch::kDouble);  // the weights are float32
  EXPECT_THROW(model->encode(mesh.positions.to(torch::kDouble), mesh.operators),
               std::runtime_error);
  EXPECT_THROW(model->decode(features, mesh.operators, doubles), std::runtime_error);
  EXPECT_THROW(FrameDecoder(model.ptr(), features, mesh.operators).decode(doubles),
               std::runtime_error);
}

}  // namespace
}  // namespace freetalk::stm
