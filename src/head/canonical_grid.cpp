#include "head/canonical_grid.h"

#include <torch/torch.h>

#include <cmath>

#include "core/parallel.h"

namespace freetalk::head {
namespace {

constexpr int64_t kMargin = 3;  // cells beyond the box: a deformation reaches over its edge
constexpr int64_t kGridGrain = 4096;
constexpr uint8_t kAsked = 1, kReady = 2;  // a corner; a cell whose 64 corners are known

/// Weights of the corners -1, 0, 1, 2 at t in [0, 1).
void cubic_weights(float t, float* w) {
  const float u = 1 - t;
  w[0] = -0.5F * t * u * u;
  w[1] = 1 + t * t * (1.5F * t - 2.5F);
  w[2] = 1 + u * u * (1.5F * u - 2.5F);
  w[3] = -0.5F * u * t * t;
}

}  // namespace

CanonicalGrid::CanonicalGrid(const PreparedHead& head, int64_t cells)
    : head_(head), lattice_(cells + 2 * kMargin + 1) {
  for (size_t axis = 0; axis < 3; ++axis) {
    const double low = head.options().box_min[axis], high = head.options().box_max[axis];
    spacing_[axis] = (high - low) / static_cast<double>(cells);
    origin_[axis] = low - kMargin * spacing_[axis];
  }
}

bool CanonicalGrid::locate(const float* point, int64_t* cell, float* within) const {
  for (int axis = 0; axis < 3; ++axis) {
    const double at = (point[axis] - origin_[axis]) / spacing_[axis];
    if (!(at >= 1 && at < static_cast<double>(lattice_.side() - 2))) return false;
    cell[axis] = static_cast<int64_t>(at);
    within[axis] = static_cast<float>(at - static_cast<double>(cell[axis]));
  }
  return true;
}

void CanonicalGrid::ask_missing(const float* points, int64_t count) {
  std::vector<int64_t> missing;
  for (int64_t index = 0; index < count; ++index) {
    int64_t cell[3];
    float within[3];
    if (!locate(points + 3 * index, cell, within)) continue;
    const int64_t id = lattice_.id(cell[0], cell[1], cell[2]);
    if (lattice_.mark(id) & kReady) continue;
    lattice_.mark(id) |= kReady;
    for (int64_t x = cell[0] - 1; x <= cell[0] + 2; ++x) {
      for (int64_t y = cell[1] - 1; y <= cell[1] + 2; ++y) {
        for (int64_t z = cell[2] - 1; z <= cell[2] + 2; ++z) {
          const int64_t corner = lattice_.id(x, y, z);
          if (lattice_.mark(corner) & kAsked) continue;
          lattice_.mark(corner) |= kAsked;
          missing.push_back(corner);
        }
      }
    }
  }
  if (missing.empty()) return;
  const at::Tensor values = head_.unfaded_sdf(lattice_.points(missing, origin_, spacing_));
  const auto* from = values.const_data_ptr<float>();
  for (const int64_t corner : missing) lattice_.value(corner) = *from++;
  num_evaluations_ += static_cast<int64_t>(missing.size());
}

at::Tensor CanonicalGrid::sdf(const at::Tensor& points) {
  const int64_t count = points.size(0);
  const at::Tensor from = points.contiguous();
  const auto* data = from.const_data_ptr<float>();
  ask_missing(data, count);
  at::Tensor result = at::empty({count}, at::kFloat);
  auto* to = result.mutable_data_ptr<float>();
  core::parallel_for(0, count, kGridGrain, [&](int64_t first, int64_t last) {
    for (int64_t index = first; index < last; ++index) {
      int64_t cell[3];
      float within[3], wx[4], wy[4], wz[4];
      if (!locate(data + 3 * index, cell, within)) {
        to[index] = std::numeric_limits<float>::quiet_NaN();
        continue;
      }
      cubic_weights(within[0], wx);
      cubic_weights(within[1], wy);
      cubic_weights(within[2], wz);
      float sum = 0;
      for (int64_t x = 0; x < 4; ++x) {
        for (int64_t y = 0; y < 4; ++y) {
          float line = 0;
          for (int64_t z = 0; z < 4; ++z) {
            line += wz[z] * lattice_.known(cell[0] + x - 1, cell[1] + y - 1, cell[2] + z - 1);
          }
          sum += wx[x] * wy[y] * line;
        }
      }
      to[index] = sum;
    }
  });
  const at::Tensor beyond = result.isnan().nonzero().squeeze(1);
  if (beyond.numel() > 0) {
    result.index_copy_(0, beyond, head_.unfaded_sdf(from.index_select(0, beyond)));
    num_evaluations_ += beyond.size(0);
  }
  return result;
}

}  // namespace freetalk::head
