// Values at the corners of a fine grid, of which few are ever asked for: blocks of 8 x 8 x 8
// corners made when first touched.
#pragma once

#include <ATen/ATen.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <vector>

namespace freetalk::head {

class Lattice {
 public:
  /// @param side corners along each axis.
  explicit Lattice(int64_t side)
      : side_(side),
        blocks_((side + 7) / 8),
        table_(static_cast<size_t>(blocks_ * blocks_ * blocks_), -1) {}

  int64_t side() const { return side_; }
  int64_t id(int64_t x, int64_t y, int64_t z) const { return (x * side_ + y) * side_ + z; }
  std::array<int64_t, 3> place(int64_t id) const {
    return {id / (side_ * side_), id / side_ % side_, id % side_};
  }

  /// Places (N, 3) float32 of corners of a grid that begins at `origin`.
  at::Tensor points(const std::vector<int64_t>& corners, const double* origin,
                    const double* spacing) const {
    at::Tensor result = at::empty({static_cast<int64_t>(corners.size()), 3}, at::kFloat);
    auto* to = result.mutable_data_ptr<float>();
    for (const int64_t corner : corners) {
      const auto at = place(corner);
      for (size_t axis = 0; axis < 3; ++axis) {
        *to++ = static_cast<float>(origin[axis] + static_cast<double>(at[axis]) * spacing[axis]);
      }
    }
    return result;
  }

  /// The value at a corner; NaN where none was given.
  float& value(int64_t id) { return values_[slot(id)]; }
  /// The value at a corner of a block that was touched; safe to ask from several threads.
  float known(int64_t x, int64_t y, int64_t z) const {
    return values_[static_cast<size_t>(table_[block(x, y, z)] + within(x, y, z))];
  }
  /// A mark of a corner, 0 at first.
  uint8_t& mark(int64_t id) { return marks_[slot(id)]; }
  /// A number of a corner, -1 at first.
  int32_t& number(int64_t id) { return numbers_[slot(id)]; }

  /// Forgets everything.
  void clear() {
    std::fill(table_.begin(), table_.end(), -1);
    values_.clear();
    marks_.clear();
    numbers_.clear();
  }

 private:
  size_t block(int64_t x, int64_t y, int64_t z) const {
    return static_cast<size_t>(((x >> 3) * blocks_ + (y >> 3)) * blocks_ + (z >> 3));
  }
  static int64_t within(int64_t x, int64_t y, int64_t z) {
    return ((x & 7) * 8 + (y & 7)) * 8 + (z & 7);
  }
  size_t slot(int64_t id) {
    const auto [x, y, z] = place(id);
    int64_t& first = table_[block(x, y, z)];
    if (first < 0) {
      first = static_cast<int64_t>(values_.size());
      values_.resize(values_.size() + 512, std::numeric_limits<float>::quiet_NaN());
      marks_.resize(values_.size(), 0);
      numbers_.resize(values_.size(), -1);
    }
    return static_cast<size_t>(first + within(x, y, z));
  }

  int64_t side_, blocks_;
  std::vector<int64_t> table_;
  std::vector<float> values_;
  std::vector<uint8_t> marks_;
  std::vector<int32_t> numbers_;
};

}  // namespace freetalk::head
