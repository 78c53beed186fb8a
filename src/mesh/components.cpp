#include "freetalk/mesh/components.h"

#include <algorithm>
#include <numeric>
#include <vector>

#include "mesh/union_find.h"

namespace freetalk::mesh {

Eigen::VectorXi connected_components(int64_t num_vertices, const Eigen::MatrixXi& faces) {
  UnionFind parts(static_cast<size_t>(num_vertices));
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int c = 1; c < 3; ++c) parts.join(faces(f, 0), faces(f, c));
  }
  const std::vector<int> labels = parts.labels();
  return Eigen::Map<const Eigen::VectorXi>(labels.data(), num_vertices);
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
