#include "head/identity_engine.h"

#include <torch/torch.h>

#include <algorithm>
#include <cmath>

#include "core/parallel.h"
#include "head/constants.h"

namespace freetalk::head {
namespace {

constexpr int64_t kChunk = 4096;      // points whose rows are gathered together
constexpr float kNegligible = 16.0F;  // exponents below the largest: weights below 1.2e-7 of it

}  // namespace

IdentityEngine::IdentityEngine(const IdentityFieldImpl& field, const at::Tensor& anchors,
                               bool bfloat16)
    : options_(field.options()) {
  const auto networks = nn::networks_of_members(options_.num_members(), options_.num_pairs);
  const at::Tensor placed = anchors.to(at::kFloat).contiguous();
  for (int64_t index = 0; index < options_.num_members(); ++index) {
    Member member{networks[static_cast<size_t>(index)], {0, 0, 0}, 1};
    if (index < options_.num_anchors) {
      std::copy_n(placed.const_data_ptr<float>() + 3 * index, 3, member.origin);
    }
    if (index < 2 * options_.num_pairs && index % 2 == 1) member.mirror = -1;
    members_.push_back(member);
  }
  for (const auto& layers : nn::layers_of(*field.local_networks())) {
    networks_.emplace_back(options_.local_mlp(), layers, bfloat16);
  }
}

std::vector<nn::FoldedCode> IdentityEngine::fold(const at::Tensor& codes) const {
  std::vector<nn::FoldedCode> result;
  for (size_t member = 0; member < members_.size(); ++member) {
    const auto network = static_cast<size_t>(members_[member].network);
    result.push_back(networks_[network].fold(codes[static_cast<int64_t>(member)]));
  }
  return result;
}

at::Tensor IdentityEngine::run(const at::Tensor& points, const std::vector<nn::FoldedCode>& codes,
                               bool fade) const {
  const int64_t count = points.size(0), dim = points.size(1);
  at::Tensor result = at::empty({count}, at::kFloat);
  const auto* from = points.const_data_ptr<float>();
  auto* to = result.mutable_data_ptr<float>();
  core::parallel_for(0, (count + kChunk - 1) / kChunk, 1, [&](int64_t first, int64_t last) {
    for (int64_t chunk = first; chunk < last; ++chunk) {
      const int64_t begin = chunk * kChunk;
      run_chunk(from + begin * dim, std::min(kChunk, count - begin), codes, fade, to + begin);
    }
  });
  return result;
}

void IdentityEngine::gather(const float* point, int32_t index, bool fade,
                            std::vector<std::vector<Row>>& rows) const {
  const auto variance = static_cast<float>(options_.kernel_width * options_.kernel_width);
  const size_t members = members_.size();
  float exponents[kMaxMembers];
  float largest = static_cast<float>(kBackgroundExponent);
  for (size_t member = 0; member + 1 < members; ++member) {
    float square = 0;
    for (int axis = 0; axis < 3; ++axis) {
      const float d = point[axis] - members_[member].origin[axis];
      square += d * d;
    }
    const float distance = std::sqrt(square) + static_cast<float>(kDistanceOffset);
    exponents[member] = -distance * distance / variance;
    largest = std::max(largest, exponents[member]);
  }
  exponents[members - 1] = static_cast<float>(kBackgroundExponent);
  float weights[kMaxMembers], total = 0;
  for (size_t member = 0; member < members; ++member) {
    const bool counts = exponents[member] > largest - kNegligible;
    weights[member] = counts ? std::exp(exponents[member]) : 0.0F;
    total += weights[member];
  }
  const float normalizer = total + (fade ? static_cast<float>(options_.normalizer_eps) : 0.0F);
  const float least = static_cast<float>(options_.min_weight) * normalizer;
  float kept = 0;
  for (size_t member = 0; member < members; ++member) {
    if (weights[member] > least) kept += weights[member];
  }
  if (kept == 0) return;
  const float scale = options_.min_weight > 0 ? total / normalizer / kept : 1 / normalizer;
  for (size_t member = 0; member < members; ++member) {
    if (weights[member] > least) rows[member].push_back({index, weights[member] * scale});
  }
}

void IdentityEngine::run_chunk(const float* points, int64_t count,
                               const std::vector<nn::FoldedCode>& codes, bool fade,
                               float* result) const {
  const int64_t dim = 3 + options_.hyper_dim;
  std::vector<std::vector<Row>> rows(members_.size());
  for (int64_t point = 0; point < count; ++point) {
    gather(points + point * dim, static_cast<int32_t>(point), fade, rows);
  }
  std::fill_n(result, count, 0.0F);
  std::vector<float> local, values;
  for (size_t index = 0; index < members_.size(); ++index) {
    const Member& member = members_[index];
    const std::vector<Row>& own = rows[index];
    if (own.empty()) continue;
    values.assign(own.size(), 1.0F);  // the background where it is outside
    if (index + 1 < members_.size() || options_.background == "learned") {
      local.resize(own.size() * static_cast<size_t>(dim));
      for (size_t row = 0; row < own.size(); ++row) {
        const float* point = points + own[row].point * dim;
        float* at = local.data() + row * static_cast<size_t>(dim);
        std::copy_n(point, dim, at);
        for (int axis = 0; axis < 3; ++axis) at[axis] -= member.origin[axis];
        at[0] *= member.mirror;
      }
      networks_[static_cast<size_t>(member.network)].run(
          local.data(), static_cast<int64_t>(own.size()), codes[index], values.data());
    }
    for (size_t row = 0; row < own.size(); ++row) {
      result[own[row].point] += own[row].weight * values[row];
    }
  }
}

}  // namespace freetalk::head
