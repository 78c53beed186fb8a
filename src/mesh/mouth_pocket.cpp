#include "mesh/mouth_pocket.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "core/smoothstep.h"

namespace freetalk::mesh {
namespace {

constexpr int kRings = 6;
constexpr double kRoof = 0.4, kFloor = 0.5;  // of the depth, above and below the slit
constexpr double kNarrowing = 0.25;          // towards the middle, at the end
constexpr double kCornerDepth = 0.35;        // of the depth, at the corners
constexpr double kColumn = 0.0025;           // m from one column of the rings to the next

/// Places on a lip, both ends among them and at least two between, about kColumn apart.
std::vector<size_t> columns_of(const Eigen::MatrixXd& vertices, const std::vector<RimVertex>& lip) {
  std::vector<double> length{0.0};
  for (size_t i = 1; i < lip.size(); ++i) {
    const double step = (vertices.row(lip[i].vertex) - vertices.row(lip[i - 1].vertex)).norm();
    length.push_back(length.back() + step);
  }
  const size_t n = lip.size() - 1;
  const auto wanted = std::clamp<size_t>(std::lround(length.back() / kColumn), 3, n);
  const double step = length.back() / static_cast<double>(wanted);
  std::vector<size_t> columns{0};
  for (size_t i = 1; i < n; ++i) {
    const bool last = n - i < 3 && columns.size() < 3;  // two are needed, and few are left
    if (length[i] >= step * static_cast<double>(columns.size()) || last) columns.push_back(i);
  }
  columns.push_back(n);
  return columns;
}

}  // namespace

void sew_pocket(const std::vector<RimVertex>& upper, const std::vector<RimVertex>& lower,
                double depth, int origin, Reshaped& slit) {
  Eigen::MatrixXd& vertices = slit.mesh.vertices;
  const size_t n = upper.size() - 1;
  const std::vector<size_t> columns = columns_of(vertices, upper);
  const int across = static_cast<int>(columns.size()) - 1;
  std::vector<RimVertex> rim(lower.begin(), lower.end());  // the lower lip, then the upper back
  for (size_t i = n - 1; i > 0; --i) rim.push_back(upper[i]);
  std::vector<size_t> column(columns);  // of the rings: places on the rim
  for (int c = across - 1; c > 0; --c) column.push_back(2 * n - columns[static_cast<size_t>(c)]);
  Eigen::RowVector3d middle = Eigen::RowVector3d::Zero();
  for (const RimVertex& each : rim) {
    middle += vertices.row(each.vertex) / static_cast<double>(rim.size());
  }
  const auto size = static_cast<int>(column.size());
  const int first = static_cast<int>(vertices.rows());
  vertices.conservativeResize(first + kRings * size, 3);
  for (int ring = 0; ring < kRings; ++ring) {
    const double far = static_cast<double>(ring + 1) / kRings;
    for (int k = 0; k < size; ++k) {
      const size_t place = column[static_cast<size_t>(k)];
      const bool above = place > n;
      const auto along =
          static_cast<double>(above ? 2 * n - place : place) / static_cast<double>(n);
      const double inner = std::sin(std::numbers::pi * along);  // 0 at the corners
      Eigen::RowVector3d at = vertices.row(rim[place].vertex);
      at[0] += kNarrowing * far * (middle[0] - at[0]);
      at[1] += (above ? kRoof : -kFloor) * depth * std::sqrt(inner) * core::smoothstep(far);
      at[2] -= depth * far * (kCornerDepth + (1 - kCornerDepth) * inner);
      vertices.row(first + ring * size + k) = at;
      slit.added.push_back({rim[place].vertex, rim[place].vertex, 0.0});
    }
  }
  // A corner is the ring it lies on, 0 being the rim itself, and its place there.
  const auto add = [&](const std::vector<std::pair<int, int>>& corners) {
    std::vector<int> polygon, texture;
    for (const auto& [ring, k] : corners) {
      const RimVertex& from = rim[ring == 0 ? static_cast<size_t>(k) % rim.size()
                                            : column[static_cast<size_t>(k % size)]];
      polygon.push_back(ring == 0 ? from.vertex : first + (ring - 1) * size + k % size);
      if (from.texcoord >= 0) texture.push_back(from.texcoord);
    }
    if (texture.size() < polygon.size()) texture.clear();
    slit.mesh.polygons.push_back(polygon);
    if (slit.mesh.texcoords.rows() > 0) slit.mesh.polygon_texcoords.push_back(texture);
    slit.polygon_origin.push_back(origin);
  };
  for (int k = 0; k < size; ++k) {
    const auto from = static_cast<int>(column[static_cast<size_t>(k)]);
    const int to = k + 1 < size ? static_cast<int>(column[static_cast<size_t>(k) + 1])
                                : static_cast<int>(rim.size());
    const int half = (from + to) / 2;
    for (int i = from; i < to; ++i) {
      if (i == half) add({{0, i}, {1, k + 1}, {1, k}});
      add({{0, i}, {0, i + 1}, {1, i < half ? k : k + 1}});
    }
  }
  for (int ring = 1; ring < kRings; ++ring) {
    for (int k = 0; k < size; ++k) {
      add({{ring, k}, {ring, k + 1}, {ring + 1, k + 1}, {ring + 1, k}});
    }
  }
  const int r = kRings;
  add({{r, 0}, {r, 1}, {r, size - 1}});
  for (int i = 1; i + 1 < across; ++i) {
    add({{r, i}, {r, i + 1}, {r, size - i - 1}, {r, size - i}});
  }
  add({{r, across - 1}, {r, across}, {r, across + 1}});
}

}  // namespace freetalk::mesh
