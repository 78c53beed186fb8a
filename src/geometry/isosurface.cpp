#include "freetalk/geometry/isosurface.h"

#include <algorithm>
#include <bit>
#include <limits>
#include <numeric>
#include <vector>

#include "core/parallel.h"
#include "freetalk/core/error.h"
#include "geometry/marching_cubes.h"

namespace freetalk::geometry {
namespace {

constexpr int64_t kWord = 64;

/// Bit b is set where values[b] lies below the level, for b < count.
uint64_t below_bits(const float* values, int64_t count, float level) {
  static constexpr auto kBits = [] {
    std::array<uint32_t, 32> bits{};
    for (int b = 0; b < 32; ++b) bits[b] = uint32_t{1} << b;
    return bits;
  }();
  uint64_t word = 0;
  for (int64_t half = 0; half < 2 && count > 32 * half; ++half) {
    const float* from = values + 32 * half;
    uint32_t bits = 0;
    if (count >= 32 * (half + 1)) {
      for (int b = 0; b < 32; ++b) bits |= from[b] < level ? kBits[b] : 0u;
    } else {
      for (int b = 0; b < count - 32 * half; ++b) bits |= from[b] < level ? kBits[b] : 0u;
    }
    word |= static_cast<uint64_t>(bits) << 32 * half;
  }
  return word;
}

/// A dense grid of slabs x of rows y of values z; which of them lie below the level, a bit each.
class DenseGrid {
 public:
  DenseGrid(const float* values, const std::array<int64_t, 3>& shape,
            const IsosurfaceOptions& options)
      : values_(values),
        options_(options),
        level_(static_cast<float>(options.level)),
        x_(shape[0]),
        y_(shape[1]),
        z_(shape[2]),
        words_((z_ + kWord - 1) / kWord),
        below_(static_cast<size_t>(x_ * y_ * words_)) {}

  Isosurface extract() {
    core::parallel_for(0, x_, 1, [&](int64_t begin, int64_t end) {
      for (int64_t x = begin; x < end; ++x) mark(x);
    });
    std::vector<int64_t> vertices(static_cast<size_t>(x_) + 1), faces(vertices.size());
    core::parallel_for(0, x_, 1, [&](int64_t begin, int64_t end) {
      for (int64_t x = begin; x < end; ++x) {
        each_edge(x, [&](int, int64_t, int64_t) { ++vertices[static_cast<size_t>(x) + 1]; });
        each_cell(x, [&](int64_t, int64_t, int cube) {
          faces[static_cast<size_t>(x) + 1] += table_.cases[static_cast<size_t>(cube)].triangles;
        });
      }
    });
    std::partial_sum(vertices.begin(), vertices.end(), vertices.begin());
    std::partial_sum(faces.begin(), faces.end(), faces.begin());
    FREETALK_CHECK(std::max(vertices.back(), faces.back()) <= std::numeric_limits<int>::max(),
                   "the surface has ", faces.back(), " triangles: use a coarser grid");
    Isosurface surface{Eigen::MatrixXd(vertices.back(), 3), Eigen::MatrixXi(faces.back(), 3)};
    core::parallel_for(0, x_, 8, [&](int64_t begin, int64_t end) {
      std::vector<int> ids(static_cast<size_t>(6 * y_ * z_));  // of slabs x and x + 1 by turns
      number(begin, vertices[static_cast<size_t>(begin)], ids);
      for (int64_t x = begin; x < end; ++x) {
        if (x + 1 < x_) number(x + 1, vertices[static_cast<size_t>(x) + 1], ids);
        place(x, vertices[static_cast<size_t>(x)], surface.vertices);
        connect(x, faces[static_cast<size_t>(x)], ids, surface.faces);
      }
    });
    return surface;
  }

 private:
  const uint64_t* row(int64_t x, int64_t y) const { return &below_[(x * y_ + y) * words_]; }

  static bool at(const uint64_t* row, int64_t z) { return (row[z / kWord] >> z % kWord & 1) != 0; }

  /// Bits z + 1 of a row at the places z of a word.
  uint64_t shifted(const uint64_t* row, int64_t word) const {
    const uint64_t carry = word + 1 < words_ ? row[word + 1] << (kWord - 1) : 0;
    return row[word] >> 1 | carry;
  }

  /// The places of a word that have a neighbour at z + 1.
  uint64_t inner(int64_t word) const {
    const int64_t count = std::min(kWord, z_ - 1 - word * kWord);
    return count == kWord ? ~uint64_t{0} : (uint64_t{1} << std::max<int64_t>(count, 0)) - 1;
  }

  void mark(int64_t x) {
    for (int64_t y = 0; y < y_; ++y) {
      const float* from = values_ + (x * y_ + y) * z_;
      uint64_t* bits = &below_[(x * y_ + y) * words_];
      for (int64_t w = 0; w < words_; ++w) {
        bits[w] = below_bits(from + w * kWord, std::min(kWord, z_ - w * kWord), level_);
      }
    }
  }

  template <class Body>
  static void each_bit(uint64_t bits, int64_t word, const Body& body) {
    for (; bits != 0; bits &= bits - 1) body(word * kWord + std::countr_zero(bits));
  }

  /// Calls body(axis, y, z) for the crossed edges whose lower ends lie in slab x, in their order.
  template <class Body>
  void each_edge(int64_t x, const Body& body) const {
    for (int64_t y = 0; y < y_; ++y) {
      const uint64_t* from = row(x, y);
      for (int64_t w = 0; w < words_; ++w) {
        each_bit((from[w] ^ shifted(from, w)) & inner(w), w, [&](int64_t z) { body(2, y, z); });
      }
      if (y + 1 < y_) {
        const uint64_t* to = row(x, y + 1);
        for (int64_t w = 0; w < words_; ++w) {
          each_bit(from[w] ^ to[w], w, [&](int64_t z) { body(1, y, z); });
        }
      }
      if (x + 1 < x_) {
        const uint64_t* to = row(x + 1, y);
        for (int64_t w = 0; w < words_; ++w) {
          each_bit(from[w] ^ to[w], w, [&](int64_t z) { body(0, y, z); });
        }
      }
    }
  }

  /// Calls body(y, z, cube) for the cells between slabs x and x + 1 that cross the level.
  template <class Body>
  void each_cell(int64_t x, const Body& body) const {
    if (x + 1 == x_) return;
    for (int64_t y = 0; y + 1 < y_; ++y) {
      const std::array<const uint64_t*, 4> rows{row(x, y), row(x, y + 1), row(x + 1, y),
                                                row(x + 1, y + 1)};
      for (int64_t w = 0; w < words_; ++w) {
        uint64_t any = 0, all = ~uint64_t{0};
        for (const uint64_t* r : rows) {
          any |= r[w] | shifted(r, w);
          all &= r[w] & shifted(r, w);
        }
        each_bit(any & ~all & inner(w), w, [&](int64_t z) {
          int cube = 0;
          for (int i = 0; i < 4; ++i) {
            cube |= at(rows[i], z) << 2 * i | at(rows[i], z + 1) << (2 * i + 1);
          }
          body(y, z, cube);
        });
      }
    }
  }

  int64_t slot(int64_t x, int axis) const { return (x % 2 * 3 + axis) * y_ * z_; }

  void number(int64_t x, int64_t first, std::vector<int>& ids) const {
    each_edge(x, [&](int axis, int64_t y, int64_t z) {
      ids[static_cast<size_t>(slot(x, axis) + y * z_ + z)] = static_cast<int>(first++);
    });
  }

  void place(int64_t x, int64_t first, Eigen::MatrixXd& vertices) const {
    const std::array<int64_t, 3> step{y_ * z_, z_, 1};
    each_edge(x, [&](int axis, int64_t y, int64_t z) {
      const float* from = values_ + x * step[0] + y * step[1] + z;
      Eigen::Vector3d index(static_cast<double>(x), static_cast<double>(y), static_cast<double>(z));
      index[axis] += crossing(from[0], from[step[axis]], options_.level);
      for (int c = 0; c < 3; ++c) {
        vertices(first, c) = options_.origin[c] + options_.spacing[c] * index[c];
      }
      ++first;
    });
  }

  void connect(int64_t x, int64_t first, const std::vector<int>& ids,
               Eigen::MatrixXi& faces) const {
    std::array<int64_t, kCellEdges> offsets;
    for (int e = 0; e < kCellEdges; ++e) {
      const auto [corner, axis] = table_.edges[e];
      offsets[e] = slot(x + (corner >> 2), axis) + (corner >> 1 & 1) * z_ + (corner & 1);
    }
    each_cell(x, [&](int64_t y, int64_t z, int cube) {
      const CubeCase& pieces = table_.cases[static_cast<size_t>(cube)];
      const int* here = ids.data() + y * z_ + z;
      for (int t = 0; t < pieces.triangles; ++t, ++first) {
        for (int c = 0; c < 3; ++c) faces(first, c) = here[offsets[pieces.edges[3 * t + c]]];
      }
    });
  }

  const float* values_;
  const IsosurfaceOptions& options_;
  float level_;
  int64_t x_, y_, z_, words_;
  std::vector<uint64_t> below_;
  const MarchingCubes& table_ = marching_cubes();
};

int case_of(const CellCorners& cells, Eigen::Index cell, const Eigen::VectorXf& values,
            double level) {
  int cube = 0;
  for (int c = 0; c < 8; ++c) cube |= (values[cells(cell, c)] < level) << c;
  return cube;
}

}  // namespace

Isosurface isosurface(const float* values, const std::array<int64_t, 3>& shape,
                      const IsosurfaceOptions& options) {
  FREETALK_CHECK(std::min({shape[0], shape[1], shape[2]}) >= 2,
                 "values of a grid need a shape (X, Y, Z) of at least 2 each, found (", shape[0],
                 ", ", shape[1], ", ", shape[2], ")");
  FREETALK_CHECK(options.spacing.minCoeff() > 0.0, "spacing must be above 0, found ",
                 options.spacing.transpose());
  return DenseGrid(values, shape, options).extract();
}

Isosurface isosurface_of_cells(const Eigen::MatrixXd& corners, const Eigen::VectorXf& values,
                               const CellCorners& cells, double level) {
  const Eigen::Index count = corners.rows(), num_cells = cells.rows();
  FREETALK_CHECK(corners.cols() == 3 && values.size() == count,
                 "corners (P, 3) need values (P,), found (", count, ", ", corners.cols(), ") and (",
                 values.size(), ",)");
  FREETALK_CHECK(num_cells == 0 || (cells.minCoeff() >= 0 && cells.maxCoeff() < count),
                 "cells must name rows of the ", count, " corners");
  const MarchingCubes& table = marching_cubes();
  std::vector<int> other_end(static_cast<size_t>(3 * count), -1);  // of each corner's upward edges
  std::vector<int64_t> first(static_cast<size_t>(num_cells) + 1);
  for (Eigen::Index n = 0; n < num_cells; ++n) {
    const int cube = case_of(cells, n, values, level);
    first[static_cast<size_t>(n) + 1] = first[static_cast<size_t>(n)] + table.cases[cube].triangles;
    if (cube == 0 || cube == 255) continue;
    for (const CellEdge& edge : table.edges) {
      if ((cube >> edge.corner & 1) != (cube >> edge.end() & 1)) {
        other_end[3 * cells(n, edge.corner) + edge.axis] = cells(n, edge.end());
      }
    }
  }
  std::vector<int> id(other_end.size());
  int num_vertices = 0;
  for (size_t e = 0; e < id.size(); ++e) {
    id[e] = num_vertices;
    num_vertices += other_end[e] >= 0;
  }
  Isosurface surface{Eigen::MatrixXd(num_vertices, 3), Eigen::MatrixXi(first.back(), 3)};
  core::parallel_for(0, count, 4096, [&](int64_t begin, int64_t end) {
    for (int64_t e = 3 * begin; e < 3 * end; ++e) {
      const int to = other_end[e], from = static_cast<int>(e / 3);
      if (to < 0) continue;
      const double t = crossing(values[from], values[to], level);
      surface.vertices.row(id[e]) = (1.0 - t) * corners.row(from) + t * corners.row(to);
    }
  });
  core::parallel_for(0, num_cells, 4096, [&](int64_t begin, int64_t end) {
    for (int64_t n = begin; n < end; ++n) {
      const CubeCase& pieces = table.cases[case_of(cells, n, values, level)];
      for (int i = 0; i < 3 * pieces.triangles; ++i) {
        const CellEdge& edge = table.edges[pieces.edges[i]];
        surface.faces(first[n] + i / 3, i % 3) = id[3 * cells(n, edge.corner) + edge.axis];
      }
    }
  });
  return surface;
}

}  // namespace freetalk::geometry
