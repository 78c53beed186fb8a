#include "freetalk/animation/morph.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/scratch.h"
#include "freetalk/core/error.h"

namespace freetalk::animation {
namespace {

constexpr int64_t kColumns = 3 * 2048;  // of D at once
constexpr int64_t kGramFrames = 512;
constexpr int64_t kRankStep = 2;  // targets added at once

/// (K, 3V) double orthonormal rows spanning the leading right singular vectors of D, K <=
/// max_targets.
at::Tensor right_singular_vectors(const at::Tensor& motion, int64_t max_targets) {
  const int64_t columns = motion.size(1);
  at::Tensor sample = motion;
  if (motion.size(0) > kGramFrames) {
    sample = motion.index_select(
        0, at::linspace(0, motion.size(0) - 1, kGramFrames, at::kDouble).round().to(at::kLong));
    core::release_pages(motion);
  }
  const int64_t rows = sample.size(0);
  const bool by_frames = rows <= columns;
  auto gram = at::zeros({std::min(rows, columns), std::min(rows, columns)}, at::kDouble);
  if (by_frames) {
    for (int64_t start = 0; start < columns; start += kColumns) {
      const auto block =
          sample.slice(1, start, std::min(start + kColumns, columns)).to(at::kDouble);
      gram += block.matmul(block.t());
    }
  } else {
    const auto block = sample.to(at::kDouble);
    gram = block.t().matmul(block);
  }
  const auto [values, vectors] = at::linalg_eigh(gram);  // ascending
  const double floor = 1e-12 * std::max(values.max().item<double>(), 1e-300);
  const int64_t rank = (values > floor).sum().item<int64_t>();
  const int64_t count = std::min(rank, max_targets);
  const auto leading =
      vectors.slice(1, vectors.size(1) - count).flip(1).t().contiguous();  // (K, n)
  if (!by_frames) return leading;
  const auto scale = values.slice(0, values.size(0) - count).flip(0).sqrt();
  auto basis = at::empty({count, columns}, at::kDouble);
  for (int64_t start = 0; start < columns; start += kColumns) {
    const int64_t stop = std::min(start + kColumns, columns);
    basis.slice(1, start, stop)
        .copy_(leading.matmul(sample.slice(1, start, stop).to(at::kDouble)) / scale.view({-1, 1}));
  }
  return basis;
}

/// Calls visit(start, stop) for blocks of whole vertices, about a million frames x vertices each.
template <class Visit>
void for_blocks(const at::Tensor& motion, const Visit& visit) {
  const int64_t columns = motion.size(1);
  const int64_t step = 3 * std::max<int64_t>(1, (int64_t{1} << 20) / motion.size(0));
  for (int64_t start = 0; start < columns; start += step) {
    visit(start, std::min(start + step, columns));
    core::release_pages(motion);
  }
}

/// Largest vertex error that `rank` targets leave in columns start ... stop.
double block_error(const at::Tensor& motion, const at::Tensor& weights, const at::Tensor& basis,
                   int64_t rank, int64_t start, int64_t stop) {
  const auto rest = at::addmm(motion.slice(1, start, stop), weights.slice(1, 0, rank),
                              basis.slice(0, 0, rank).slice(1, start, stop), 1, -1);
  return std::sqrt(rest.view({rest.size(0), -1, 3}).square().sum(-1).max().item<double>());
}

/// The same motion with weights in [0, 1]: a target spans the range of its weights, and one more,
/// on in every frame, is where the ranges begin. @param weights (T, K). @param targets (K, 3V).
MorphBasis non_negative(const at::Tensor& weights, const at::Tensor& targets) {
  MorphBasis result;
  if (targets.size(0) == 0) {
    result.weights = weights.to(at::kFloat);
    result.targets = targets.to(at::kFloat);
    return result;
  }
  const auto low = std::get<0>(weights.min(0)).clamp_max(0.0);  // 0 is the rest pose
  const auto span = (std::get<0>(weights.max(0)).clamp_min(0.0) - low).clamp_min(1e-30);
  const auto always = at::ones({weights.size(0), 1}, weights.options());
  result.weights = at::cat({(weights - low) / span, always}, 1).to(at::kFloat).contiguous();
  result.targets =
      at::cat({targets * span.unsqueeze(1), low.unsqueeze(0).matmul(targets)}).to(at::kFloat);
  return result;
}

}  // namespace

MorphBasis morph_basis(const at::Tensor& displacements, double tolerance, int64_t max_targets) {
  FREETALK_CHECK(displacements.dim() == 3 && displacements.size(2) == 3 &&
                     displacements.scalar_type() == at::kFloat && displacements.size(0) > 0,
                 "morph_basis: displacements must be (T, V, 3) float32 with T > 0");
  FREETALK_CHECK(tolerance > 0 && max_targets >= 2,
                 "morph_basis: tolerance must be positive and max_targets at least 2");
  const int64_t frames = displacements.size(0), vertices = displacements.size(1);
  const auto motion = displacements.reshape({frames, 3 * vertices});
  const auto full = right_singular_vectors(motion, max_targets - 1);
  auto weights = at::zeros({frames, full.size(0)}, at::kDouble);
  for (int64_t start = 0; start < 3 * vertices; start += kColumns) {
    const int64_t stop = std::min(start + kColumns, 3 * vertices);
    weights += motion.slice(1, start, stop).to(at::kDouble).matmul(full.slice(1, start, stop).t());
    core::release_pages(motion);
  }
  const auto basis = full.to(at::kFloat);
  const auto weights32 = weights.to(at::kFloat);
  int64_t rank = 0;
  for_blocks(motion, [&](int64_t start, int64_t stop) {
    while (rank < full.size(0) &&
           block_error(motion, weights32, basis, rank, start, stop) > tolerance) {
      rank = std::min(rank + kRankStep, full.size(0));
    }
  });
  MorphBasis result = non_negative(weights.slice(1, 0, rank), full.slice(0, 0, rank));
  result.targets = result.targets.view({result.targets.size(0), vertices, 3});
  result.max_error = morph_error(displacements, result.weights, result.targets);
  return result;
}

double morph_error(const at::Tensor& displacements, const at::Tensor& weights,
                   const at::Tensor& targets) {
  const auto motion = displacements.reshape({displacements.size(0), -1});
  const auto flat = targets.reshape({targets.size(0), motion.size(1)});
  double error = 0.0;
  for_blocks(motion, [&](int64_t start, int64_t stop) {
    error = std::max(error, block_error(motion, weights, flat, flat.size(0), start, stop));
  });
  return error;
}

BlendShapes blend_shapes(const at::Tensor& displacements, const BlendShapes& given,
                         double tolerance, int64_t max_targets) {
  const int64_t frames = displacements.size(0), vertices = displacements.size(1);
  const auto count = static_cast<int64_t>(given.names.size());
  at::Tensor left = displacements;
  if (count > 0) {
    const std::vector<int64_t> targets{count, vertices, 3}, weights{frames, count};
    FREETALK_CHECK(given.targets.defined() && given.targets.sizes() == targets &&
                       given.weights.defined() && given.weights.sizes() == weights,
                   "blend shapes must be targets (", count, ", ", vertices, ", 3) and weights (",
                   frames, ", ", count, ")");
    FREETALK_CHECK(given.weights.ge(0).logical_and(given.weights.le(1)).all().item<bool>(),
                   "weights of blend shapes must lie in [0, 1]");
    left = core::scratch_tensor(displacements.sizes());
    const auto flat = given.targets.reshape({count, 3 * vertices});
    constexpr int64_t kFrames = 32;
    for (int64_t t = 0; t < frames; t += kFrames) {
      const int64_t stop = std::min(t + kFrames, frames);
      left.slice(0, t, stop)
          .view({stop - t, -1})
          .copy_(displacements.slice(0, t, stop).reshape({stop - t, -1}) -
                 given.weights.slice(0, t, stop).matmul(flat));
    }
  }
  const MorphBasis basis = morph_basis(left, tolerance, max_targets);
  BlendShapes result = given;
  for (int64_t k = 0; k < basis.targets.size(0); ++k) {
    result.names.push_back("motion_" + std::to_string(k));
  }
  result.targets = count > 0 ? at::cat({given.targets, basis.targets}) : basis.targets;
  result.weights = count > 0 ? at::cat({given.weights, basis.weights}, 1) : basis.weights;
  result.max_error = basis.max_error;
  return result;
}

}  // namespace freetalk::animation
