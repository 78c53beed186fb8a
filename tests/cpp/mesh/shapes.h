// Small surfaces the geometry tests share.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace freetalk::testing {

struct Shape {
  Eigen::MatrixXd vertices;
  Eigen::MatrixXi faces;
};

/// n x n vertices over [0, width] x [0, height] in the plane z = 0.
inline Shape grid(int n, double width = 1.0, double height = 1.0) {
  Shape shape{Eigen::MatrixXd(n * n, 3), Eigen::MatrixXi(2 * (n - 1) * (n - 1), 3)};
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      shape.vertices.row(i * n + j) << width * j / (n - 1), height * i / (n - 1), 0.0;
    }
  }
  int f = 0;
  for (int i = 0; i + 1 < n; ++i) {
    for (int j = 0; j + 1 < n; ++j) {
      const int a = i * n + j;
      shape.faces.row(f++) << a, a + 1, a + n + 1;
      shape.faces.row(f++) << a, a + n + 1, a + n;
    }
  }
  return shape;
}

/// Unit sphere: an octahedron subdivided `levels` times.
inline Shape sphere(int levels) {
  std::vector<Eigen::Vector3d> points{{1, 0, 0},  {-1, 0, 0}, {0, 1, 0},
                                      {0, -1, 0}, {0, 0, 1},  {0, 0, -1}};
  std::vector<Eigen::Vector3i> faces{{0, 2, 4}, {2, 1, 4}, {1, 3, 4}, {3, 0, 4},
                                     {2, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}};
  for (int level = 0; level < levels; ++level) {
    std::map<std::pair<int, int>, int> middles;
    const auto middle = [&](int a, int b) {
      const auto key = std::minmax(a, b);
      const auto [it, added] =
          middles.try_emplace({key.first, key.second}, static_cast<int>(points.size()));
      if (added) points.push_back((points[a] + points[b]).normalized());
      return it->second;
    };
    std::vector<Eigen::Vector3i> finer;
    for (const Eigen::Vector3i& f : faces) {
      const int ab = middle(f[0], f[1]), bc = middle(f[1], f[2]), ca = middle(f[2], f[0]);
      finer.insert(finer.end(), {{f[0], ab, ca}, {f[1], bc, ab}, {f[2], ca, bc}, {ab, bc, ca}});
    }
    faces = std::move(finer);
  }
  Shape shape{Eigen::MatrixXd(points.size(), 3), Eigen::MatrixXi(faces.size(), 3)};
  for (size_t i = 0; i < points.size(); ++i) shape.vertices.row(i) = points[i];
  for (size_t i = 0; i < faces.size(); ++i) shape.faces.row(i) = faces[i];
  return shape;
}

/// Both shapes as one mesh, side by side in memory.
inline Shape join(const Shape& a, const Shape& b) {
  Shape shape{Eigen::MatrixXd(a.vertices.rows() + b.vertices.rows(), 3),
              Eigen::MatrixXi(a.faces.rows() + b.faces.rows(), 3)};
  shape.vertices << a.vertices, b.vertices;
  shape.faces << a.faces, (b.faces.array() + static_cast<int>(a.vertices.rows())).matrix();
  return shape;
}

/// A head-like surface in metres: an ellipsoid with a nose, a brow, sockets, lips and a chin, +Y
/// up, +Z forward.
inline Shape toy_head(int levels) {
  Shape shape = sphere(levels);
  for (Eigen::Index v = 0; v < shape.vertices.rows(); ++v) {
    const Eigen::Vector3d d = shape.vertices.row(v);
    const auto bump = [&d](double x, double y, double width_x, double width_y) {
      if (d.z() <= 0.0) return 0.0;
      const double u = (d.x() - x) / width_x, w = (d.y() - y) / width_y;
      return std::exp(-u * u - w * w);
    };
    Eigen::Vector3d p(0.075 * d.x(), 0.115 * d.y(), 0.095 * d.z());
    p.z() += 0.028 * bump(0, -0.05, 0.18, 0.22) - 0.016 * bump(0.42, 0.18, 0.2, 0.14) -
             0.016 * bump(-0.42, 0.18, 0.2, 0.14) + 0.008 * bump(0, -0.42, 0.3, 0.08) +
             0.012 * bump(0, -0.8, 0.3, 0.15) + 0.006 * bump(0, 0.38, 0.6, 0.1);
    shape.vertices.row(v) = p;
  }
  return shape;
}

/// A folder of its own that goes with the test.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string pattern = (std::filesystem::temp_directory_path() / "freetalk_XXXXXX").string();
    path_ = mkdtemp(pattern.data());
  }
  ~TemporaryFolder() {
    std::error_code error;
    std::filesystem::remove_all(path_, error);
  }
  std::filesystem::path write(const std::string& name, const std::string& bytes) const {
    std::ofstream(path_ / name, std::ios::binary) << bytes;
    return path_ / name;
  }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// What calling `action` throws says; empty if it throws nothing.
template <class Action>
std::string message_of(Action&& action) {
  try {
    action();
  } catch (const std::exception& error) {
    return error.what();
  }
  return {};
}

}  // namespace freetalk::testing
