#include "freetalk/mesh/components.h"

#include <algorithm>
#include <numeric>
#include <vector>

namespace freetalk::mesh {

Eigen::VectorXi connected_components(int64_t num_vertices, const Eigen::MatrixXi& faces) {
  std::vector<int> parent(static_cast<size_t>(num_vertices));
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&parent](int v) {
    while (parent[v] != v) v = parent[v] = parent[parent[v]];
    return v;
  };
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int c = 1; c < 3; ++c) {
      const int a = root(faces(f, 0));
      const int b = root(faces(f, c));
      parent[std::max(a, b)] = std::min(a, b);
    }
  }
  Eigen::VectorXi labels(num_vertices);
  int count = 0;
  for (int v = 0; v < static_cast<int>(num_vertices); ++v) {
    const int r = root(v);  // r <= v, so its label is set.
    labels[v] = r == v ? count++ : labels[r];
  }
  return labels;
}

Eigen::VectorXi coincident_vertices(const Eigen::MatrixXd& vertices) {
  std::vector<int> order(static_cast<size_t>(vertices.rows()));
  std::iota(order.begin(), order.end(), 0);
  const auto less = [&vertices](int a, int b) {
    for (int c = 0; c < 3; ++c) {
      if (vertices(a, c) != vertices(b, c)) return vertices(a, c) < vertices(b, c);
    }
    return a < b;
  };
  std::sort(order.begin(), order.end(), less);
  Eigen::VectorXi first(vertices.rows());
  for (size_t i = 0; i < order.size(); ++i) {
    const bool same = i > 0 && vertices.row(order[i]) == vertices.row(order[i - 1]);
    first[order[i]] = same ? first[order[i - 1]] : order[i];
  }
  return first;
}

}  // namespace freetalk::mesh
