#include "freetalk/geometry/surface.h"

#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>

#include "mean_normals.h"

namespace freetalk::geometry {
namespace {

Eigen::Vector3d area_vector(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                            Eigen::Index face) {
  const Eigen::Vector3d a = vertices.row(faces(face, 0));
  const Eigen::Vector3d b = vertices.row(faces(face, 1));
  const Eigen::Vector3d c = vertices.row(faces(face, 2));
  return (b - a).cross(c - a);
}

/// Neighbours of each vertex over the edges of the faces, sorted, without itself: offsets and
/// indices.
struct Adjacency {
  std::vector<int> offsets;
  std::vector<int> neighbours;
};

Adjacency vertex_adjacency(int64_t num_vertices, const Eigen::MatrixXi& faces) {
  std::vector<std::pair<int, int>> edges;
  edges.reserve(static_cast<size_t>(faces.rows()) * 6);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int c = 0; c < 3; ++c) {
      const int i = faces(f, c);
      const int j = faces(f, (c + 1) % 3);
      if (i == j) continue;
      edges.emplace_back(i, j);
      edges.emplace_back(j, i);
    }
  }
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  Adjacency adjacency;
  adjacency.offsets.assign(static_cast<size_t>(num_vertices) + 1, 0);
  adjacency.neighbours.reserve(edges.size());
  for (const auto& [i, j] : edges) {
    ++adjacency.offsets[static_cast<size_t>(i) + 1];
    adjacency.neighbours.push_back(j);
  }
  std::partial_sum(adjacency.offsets.begin(), adjacency.offsets.end(), adjacency.offsets.begin());
  return adjacency;
}

/// The guarded cotangent at a corner: `dot` of the edges from it, twice the area, longest edge
/// squared.
double guarded_cotangent(double dot, double double_area, double longest_squared,
                         Regularization regularization) {
  if (regularization == Regularization::kAbsolute) return dot / (double_area + 1e-10);
  // Slivers below a millionth of a radian count as such; the element stays positive semi-definite.
  const double denominator = std::max(double_area, 1e-6 * longest_squared);
  return denominator > 0.0 ? dot / denominator : 0.0;
}

}  // namespace

Eigen::VectorXd face_areas(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces) {
  Eigen::VectorXd areas(faces.rows());
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    areas[f] = 0.5 * area_vector(vertices, faces, f).norm();
  }
  return areas;
}

Eigen::MatrixXd face_normals(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces) {
  Eigen::MatrixXd normals(faces.rows(), 3);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    normals.row(f) = area_vector(vertices, faces, f).stableNormalized();
  }
  return normals;
}

Eigen::MatrixXd mean_normals(const Eigen::MatrixXd& of_faces, const Eigen::MatrixXi& faces,
                             Eigen::Index num_vertices) {
  Eigen::MatrixXd normals = Eigen::MatrixXd::Zero(num_vertices, 3);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int c = 0; c < 3; ++c) normals.row(faces(f, c)) += of_faces.row(f);
  }
  for (Eigen::Index v = 0; v < normals.rows(); ++v) {
    const double norm = normals.row(v).norm();
    constexpr double kCancelled = 1e-9;  // Opposite faces: what is left is rounding.
    if (norm > kCancelled) {
      normals.row(v) /= norm;
    } else {
      normals.row(v) = Eigen::RowVector3d::UnitZ();
    }
  }
  return normals;
}

Eigen::MatrixXd vertex_normals(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces) {
  return mean_normals(face_normals(vertices, faces), faces, vertices.rows());
}

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

SparseMatrix cotan_laplacian(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                             Regularization regularization) {
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(static_cast<size_t>(faces.rows()) * 12);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    const double double_area = area_vector(vertices, faces, f).norm();
    double longest_squared = 0.0;
    for (int c = 0; c < 3; ++c) {
      const Eigen::RowVector3d edge =
          vertices.row(faces(f, c)) - vertices.row(faces(f, (c + 1) % 3));
      longest_squared = std::max(longest_squared, edge.squaredNorm());
    }
    for (int c = 0; c < 3; ++c) {
      const int i = faces(f, (c + 1) % 3);
      const int j = faces(f, (c + 2) % 3);
      const Eigen::RowVector3d corner = vertices.row(faces(f, c));
      const double dot = (vertices.row(i) - corner).dot(vertices.row(j) - corner);
      const double weight =
          0.5 * guarded_cotangent(dot, double_area, longest_squared, regularization);
      entries.emplace_back(i, j, -weight);
      entries.emplace_back(j, i, -weight);
      entries.emplace_back(i, i, weight);
      entries.emplace_back(j, j, weight);
    }
  }
  SparseMatrix laplacian(vertices.rows(), vertices.rows());
  laplacian.setFromTriplets(entries.begin(), entries.end());
  return laplacian;
}

Eigen::VectorXd lumped_mass(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces) {
  const Eigen::VectorXd areas = face_areas(vertices, faces);
  Eigen::VectorXd mass = Eigen::VectorXd::Zero(vertices.rows());
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int c = 0; c < 3; ++c) mass[faces(f, c)] += areas[f] / 3.0;
  }
  if (mass.size() > 0) mass.array() += 1e-8 * mass.mean();
  return mass;
}

Eigen::MatrixXd tangent_frames(const Eigen::MatrixXd& normals) {
  Eigen::MatrixXd frames(normals.rows(), 9);
  for (Eigen::Index v = 0; v < normals.rows(); ++v) {
    const Eigen::Vector3d n = normals.row(v);
    const Eigen::Vector3d seed =
        std::abs(n.x()) < 0.9 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d::UnitY();
    const Eigen::Vector3d x = (seed - n * n.dot(seed)).normalized();
    const Eigen::Vector3d y = n.cross(x);
    frames.row(v) << x.transpose(), y.transpose(), n.transpose();
  }
  return frames;
}

RowSparseMatrix vertex_gradient(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                const Eigen::MatrixXd& frames, Regularization regularization) {
  const Eigen::Index count = vertices.rows();
  const Adjacency adjacency = vertex_adjacency(count, faces);
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(2 * (adjacency.neighbours.size() + static_cast<size_t>(count)));
  std::vector<Eigen::Vector2d> edges;
  for (Eigen::Index v = 0; v < count; ++v) {
    const int begin = adjacency.offsets[static_cast<size_t>(v)];
    const int end = adjacency.offsets[static_cast<size_t>(v) + 1];
    edges.clear();
    Eigen::Matrix2d normal_matrix = Eigen::Matrix2d::Zero();
    for (int e = begin; e < end; ++e) {
      const Eigen::RowVector3d edge = vertices.row(adjacency.neighbours[e]) - vertices.row(v);
      edges.emplace_back(edge.dot(frames.block<1, 3>(v, 0)), edge.dot(frames.block<1, 3>(v, 3)));
      normal_matrix += edges.back() * edges.back().transpose();
    }
    const bool relative = regularization == Regularization::kRelative;
    const double ridge = relative ? 1e-5 * 0.5 * normal_matrix.trace() : 1e-5;
    if (begin == end || ridge <= 0.0)
      continue;  // No edges, or all of length zero: the gradient is zero.
    const Eigen::Matrix2d inverse = (normal_matrix + ridge * Eigen::Matrix2d::Identity()).inverse();
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    for (int e = begin; e < end; ++e) {
      const Eigen::Vector2d weight = inverse * edges[static_cast<size_t>(e - begin)];
      entries.emplace_back(v, adjacency.neighbours[e], weight.x());
      entries.emplace_back(count + v, adjacency.neighbours[e], weight.y());
      sum += weight;
    }
    entries.emplace_back(v, v, -sum.x());
    entries.emplace_back(count + v, v, -sum.y());
  }
  RowSparseMatrix gradient(2 * count, count);
  gradient.setFromTriplets(entries.begin(), entries.end());
  return gradient;
}

}  // namespace freetalk::geometry
