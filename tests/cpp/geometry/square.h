// A small surface with an optional gap.
#pragma once

#include <Eigen/Core>

#include <array>
#include <vector>

namespace freetalk::geometry {

/// A square of 0.1 m with 21 x 21 vertices; with `slit`, rows 0-10 and 11-20 share no vertex but at
/// the sides.
struct Square {
  Eigen::MatrixXd vertices{441, 3};
  Eigen::MatrixXi faces;
  explicit Square(bool slit) {
    std::vector<std::array<int, 3>> triangles;
    for (int i = 0; i < 21; ++i) {
      for (int j = 0; j < 21; ++j) {
        vertices.row(21 * i + j) << 0.005 * j, 0.005 * i, 0.0;
        const bool open = slit && i == 10 && j > 1 && j < 18;
        if (i == 20 || j == 20 || open) continue;
        const int a = 21 * i + j;
        triangles.push_back({a, a + 1, a + 22});
        triangles.push_back({a, a + 22, a + 21});
      }
    }
    faces.resize(static_cast<Eigen::Index>(triangles.size()), 3);
    for (size_t f = 0; f < triangles.size(); ++f) {
      for (int c = 0; c < 3; ++c) {
        faces(static_cast<Eigen::Index>(f), c) = triangles[f][static_cast<size_t>(c)];
      }
    }
  }
};

}  // namespace freetalk::geometry
