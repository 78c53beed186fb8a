#include "head_lips.h"

#include <array>

#include "freetalk/geometry/sparse_cholesky.h"
#include "freetalk/geometry/surface.h"
#include "freetalk/mesh/weld.h"
#include "mesh/kd_tree.h"

namespace freetalk::talker {
namespace {

using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

constexpr double kMouth = 0.045;    // m
constexpr double kBlurred = 0.006;  // m from the other lip
// How firmly a value is held, in units of the Laplacian's mean diagonal: known ones; the others, so
// that a piece without any known one keeps its own.
constexpr double kHeld = 1e6, kLoose = 1e-9;

/// (V,) of the vertices near the mouth, those within kBlurred of the other lip.
std::vector<bool> blurred(const Eigen::MatrixXd& vertices, const std::vector<bool>& upper,
                          const Eigen::RowVector3d& mouth) {
  std::array<std::vector<int>, 2> lips;
  for (int v = 0; v < vertices.rows(); ++v) {
    if ((vertices.row(v) - mouth).norm() < kMouth) lips[upper[static_cast<size_t>(v)]].push_back(v);
  }
  std::vector<bool> result(static_cast<size_t>(vertices.rows()), false);
  for (const size_t side : {0, 1}) {
    const mesh::KdTree other(vertices(lips[1 - side], Eigen::all).transpose());
    for (const int v : lips[side]) {
      result[static_cast<size_t>(v)] =
          !other.nearest(vertices.row(v).transpose(), 1, kBlurred).empty();
    }
  }
  return result;
}

}  // namespace

Eigen::MatrixXd continued_to_the_lips(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                      const std::vector<bool>& upper,
                                      const Eigen::RowVector3d& mouth,
                                      const Eigen::MatrixXd& values) {
  const std::vector<bool> asked = blurred(vertices, upper, mouth);
  const mesh::WeldedSurface surface = mesh::weld(vertices, faces, "coincident");
  geometry::SparseMatrix system = geometry::cotan_laplacian(surface.vertices, surface.faces);
  const double unit = system.diagonal().mean();
  Eigen::VectorXd held = Eigen::VectorXd::Constant(system.rows(), kHeld * unit);
  Rows right(system.rows(), values.cols());
  for (Eigen::Index v = 0; v < vertices.rows(); ++v) {
    const int at = surface.vertex_of[v];
    right.row(at) = values.row(v);
    if (asked[static_cast<size_t>(v)]) held[at] = kLoose * unit;
  }
  right.array().colwise() *= held.array();
  system.diagonal() += held;
  geometry::SparseCholesky(system).solve(right.data(), right.cols());
  Eigen::MatrixXd result = values;
  for (Eigen::Index v = 0; v < vertices.rows(); ++v) {
    if (asked[static_cast<size_t>(v)]) result.row(v) = right.row(surface.vertex_of[v]);
  }
  return result;
}

}  // namespace freetalk::talker
