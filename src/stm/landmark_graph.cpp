#include "freetalk/stm/landmark_graph.h"

#include <torch/torch.h>

#include <algorithm>
#include <numeric>
#include <set>

#include "freetalk/core/error.h"

namespace freetalk::stm {
namespace {

using Edges = std::set<std::pair<int64_t, int64_t>>;

void add_edge(Edges& edges, int64_t a, int64_t b) {
  edges.insert({std::min(a, b), std::max(a, b)});
}

void add_chain(Edges& edges, int64_t first, int64_t last, bool closed) {
  for (int64_t i = first; i < last; ++i) add_edge(edges, i, i + 1);
  if (closed) add_edge(edges, last, first);
}

using Mirror = std::array<int64_t, core::kNumLandmarks>;

Mirror make_mirror() {
  Mirror mirror{};
  std::iota(mirror.begin(), mirror.end(), 0);
  const auto swap = [&mirror](int64_t a, int64_t b) {
    mirror[static_cast<size_t>(a)] = b;
    mirror[static_cast<size_t>(b)] = a;
  };
  for (int64_t i = 0; i < 8; ++i) swap(i, 16 - i);                                     // jaw
  for (int64_t i = 0; i < 5; ++i) swap(17 + i, 26 - i);                                // brows
  swap(31, 35), swap(32, 34);                                                          // nose base
  swap(36, 45), swap(37, 44), swap(38, 43), swap(39, 42), swap(40, 47), swap(41, 46);  // eyes
  swap(48, 54), swap(49, 53), swap(50, 52), swap(55, 59), swap(56, 58);                // outer lips
  swap(60, 64), swap(61, 63), swap(65, 67);                                            // inner lips
  return mirror;
}

Edges make_edges() {
  Edges edges;
  add_chain(edges, 0, 16, false);
  add_chain(edges, 17, 21, false), add_chain(edges, 22, 26, false);
  add_chain(edges, 27, 30, false), add_chain(edges, 31, 35, false);
  add_chain(edges, 36, 41, true), add_chain(edges, 42, 47, true);
  add_chain(edges, 48, 59, true), add_chain(edges, 60, 67, true);
  const std::pair<int64_t, int64_t> one_side[] = {
      {48, 60}, {49, 61}, {50, 61}, {51, 62}, {58, 67}, {57, 66}, {59, 67},  // outer to inner lips
      {61, 67}, {62, 66}, {50, 58}, {51, 57},                                // upper to lower lip
      {37, 41}, {38, 40}, {19, 37}, {20, 38}, {17, 36}, {21, 39},            // lids, brow to lid
      {21, 27}, {21, 22}, {27, 39}, {30, 31}, {30, 33}, {31, 39},            // nose
      {33, 51}, {31, 50}, {31, 48},                                          // nose to mouth
      {0, 17},  {0, 36},  {4, 48},  {6, 59},  {8, 57},  {2, 31},             // jaw to face
  };
  for (const auto& [a, b] : one_side) {
    add_edge(edges, a, b);
    add_edge(edges, landmark_mirror()[static_cast<size_t>(a)],
             landmark_mirror()[static_cast<size_t>(b)]);
  }
  for (int64_t i = 0; i < 8; ++i) add_edge(edges, i, 16 - i);  // jaw to its mirror image
  return edges;
}

}  // namespace

const Mirror& landmark_mirror() {
  static const Mirror mirror = make_mirror();
  return mirror;
}

const std::vector<std::pair<int64_t, int64_t>>& landmark_edges() {
  static const std::vector<std::pair<int64_t, int64_t>> edges = [] {
    const Edges unique = make_edges();
    return std::vector<std::pair<int64_t, int64_t>>(unique.begin(), unique.end());
  }();
  return edges;
}

at::Tensor landmark_adjacency() {
  at::Tensor adjacency = at::eye(core::kNumLandmarks, at::kFloat);
  for (const auto& [a, b] : landmark_edges()) {
    adjacency[a][b] = 1;
    adjacency[b][a] = 1;
  }
  const at::Tensor inverse_root = adjacency.sum(1).rsqrt();
  return inverse_root.unsqueeze(1) * adjacency * inverse_root.unsqueeze(0);
}

GcnImpl::GcnImpl(int64_t in_channels, int64_t hidden, int64_t num_layers) {
  FREETALK_CHECK(in_channels > 0 && hidden > 0 && num_layers > 0,
                 "GCN: channels and layers must be positive");
  adjacency_ = register_buffer("adjacency", landmark_adjacency());
  for (int64_t index = 0; index < num_layers; ++index) {
    layers_.push_back(
        register_module("layer_" + std::to_string(index),
                        torch::nn::Linear(index == 0 ? in_channels : hidden, hidden)));
  }
}

at::Tensor GcnImpl::forward(const at::Tensor& x) {
  at::Tensor y = x;
  for (size_t index = 0; index < layers_.size(); ++index) {
    const at::Tensor mixed = layers_[index](y);
    y = adjacency_.to(mixed.scalar_type()).matmul(mixed);
    if (index + 1 < layers_.size()) y = at::relu(y);
  }
  return y;
}

}  // namespace freetalk::stm
