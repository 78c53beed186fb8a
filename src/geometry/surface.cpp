#include "freetalk/geometry/surface.h"

#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>

#include "freetalk/mesh/normals.h"

namespace freetalk::geometry {
namespace {

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

SparseMatrix cotan_laplacian(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                             Regularization regularization) {
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(static_cast<size_t>(faces.rows() * 12 + vertices.rows()));
  for (int v = 0; v < vertices.rows(); ++v) entries.emplace_back(v, v, 0.0);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    const double double_area = mesh::area_vector(vertices, faces, f).norm();
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
  const Eigen::VectorXd areas = mesh::face_areas(vertices, faces);
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
