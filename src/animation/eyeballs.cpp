#include "eyeballs.h"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>

#include "core/smoothstep.h"

namespace freetalk::animation {
namespace {

constexpr double kSpacing = 3e-4;  // m between points of the ball
constexpr int kCells = 48;         // of the table along an axis
constexpr double kFront = 0.3;     // z of directions from which on all holds; below 0 nothing
constexpr double kNear = 0.015;    // m above the ball at rest: skin farther off never gets there
constexpr double kSoft = 4e-4;     // m deeper that it comes to lie, so that the lid has no kink
constexpr double kAbove = 8e-4;    // m that moving skin stays above it, unless it rests nearer

}  // namespace

Eyeball::Eyeball(const Eigen::MatrixXd& points, const Eigen::MatrixXd& skin)
    : radii_(Eigen::MatrixXd::Zero(kCells, kCells)) {
  // The sphere of least squares: |p|^2 = 2 c.p + (r^2 - |c|^2).
  Eigen::MatrixXd system(points.rows(), 4);
  system << 2 * points, Eigen::VectorXd::Ones(points.rows());
  const Eigen::Vector4d solved = system.colPivHouseholderQr().solve(points.rowwise().squaredNorm());
  centre_ = solved.head<3>();
  const double sphere = std::sqrt(std::max(0.0, solved[3] + centre_.squaredNorm()));
  const auto cell = [](double x) {
    return std::clamp(static_cast<int>((x + 1) / 2 * kCells), 0, kCells - 1);
  };
  for (const auto& point : points.rowwise()) {
    const Eigen::Vector3d from = point.transpose() - centre_;
    const double length = from.norm();
    if (from[2] <= 0) continue;
    double& radius = radii_(cell(from[0] / length), cell(from[1] / length));
    radius = std::max(radius, length);
  }
  radii_ = (radii_.array() == 0).select(sphere, radii_);
  for (int v = 0; v < skin.rows(); ++v) {
    const Eigen::Vector3d from = skin.row(v).transpose() - centre_;
    const double length = from.norm();
    if (length > sphere + kNear || from[2] < 0) continue;
    guarded_.push_back({v, from, std::min(length - radius(from / length), kAbove)});
  }
}

double Eyeball::radius(const Eigen::Vector3d& direction) const {
  // Bilinear between the centres of the cells.
  const auto place = [](double x) {
    return std::clamp((x + 1) / 2 * kCells - 0.5, 0.0, kCells - 1.001);
  };
  const double x = place(direction[0]), y = place(direction[1]);
  const int i = static_cast<int>(x), j = static_cast<int>(y);
  const double a = x - i, b = y - j;
  return (1 - a) * ((1 - b) * radii_(i, j) + b * radii_(i, j + 1)) +
         a * ((1 - b) * radii_(i + 1, j) + b * radii_(i + 1, j + 1));
}

void Eyeball::keep_out(float* displacements) const {
  for (const auto& [vertex, rest, above] : guarded_) {
    Eigen::Map<Eigen::Vector3f> moved(displacements + 3 * vertex);
    const Eigen::Vector3d from = rest + moved.cast<double>();
    const double length = from.norm();
    if (from[2] <= 0) continue;
    const double deeper = radius(from / length) + above - length;
    if (deeper <= 0) continue;
    const double front = core::smoothstep(from[2] / length / kFront);
    const double out = front * deeper * deeper / (deeper + kSoft);
    moved += (out / length * from).cast<float>();
  }
}

Eigen::MatrixXd dense_points(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                             const std::vector<bool>& chosen) {
  std::vector<Eigen::RowVector3d> found;
  for (const auto& face : faces.rowwise()) {
    if (!chosen[face[0]]) continue;
    const Eigen::RowVector3d a = vertices.row(face[0]);
    const Eigen::RowVector3d b = vertices.row(face[1]) - a, c = vertices.row(face[2]) - a;
    const int steps = static_cast<int>(std::max(b.norm(), c.norm()) / kSpacing) + 1;
    for (int i = 0; i <= steps; ++i) {
      for (int j = 0; j <= steps - i; ++j) {
        found.push_back(a + (i * b + j * c) / steps);
      }
    }
  }
  Eigen::MatrixXd points(static_cast<Eigen::Index>(found.size()), 3);
  for (size_t i = 0; i < found.size(); ++i) points.row(static_cast<Eigen::Index>(i)) = found[i];
  return points;
}

}  // namespace freetalk::animation
