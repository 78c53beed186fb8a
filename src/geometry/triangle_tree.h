// A tree of boxes over triangles, for nearest points and winding numbers.
#pragma once

#include <Eigen/Core>

#include <vector>

namespace freetalk::geometry {

/// Barycentric weights of the point of triangle abc nearest to p (Ericson, "Real-Time Collision
/// Detection", 5.1.5). An edge of no length has no say.
Eigen::Vector3d nearest_in_triangle(const Eigen::Vector3d& p, const Eigen::Vector3d& a,
                                    const Eigen::Vector3d& b, const Eigen::Vector3d& c);

class TriangleTree {
 public:
  struct Nearest {
    Eigen::Vector3d point = Eigen::Vector3d::Zero();
    double squared = 0.0;
    int face = -1;
  };

  /// @param vertices (V, 3). @param faces (F, 3) in range, F >= 1.
  TriangleTree(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces);

  Nearest nearest(const Eigen::Vector3d& point) const;
  double winding_number(const Eigen::Vector3d& point, double accuracy) const;

 private:
  static constexpr int kLeaf = 4;

  struct Triangle {
    Eigen::Vector3d a, b, c;
    int face;
  };
  struct Node {
    Eigen::Vector3d low, high;
    int begin, end;  // of triangles
    int right;       // the second child; the first one follows its parent; 0 in a leaf
    double radius;   // around `center`
    Eigen::Vector3d center, area;
    Eigen::Matrix3d moment;  // sum of (centroid - center) area^T
  };

  int build(int begin, int end);
  void set_moments(Node& node) const;

  std::vector<Triangle> triangles_;
  std::vector<Node> nodes_;
};

}  // namespace freetalk::geometry
