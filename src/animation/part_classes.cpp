#include "part_classes.h"

#include <Eigen/Cholesky>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>
#include <utility>

#include "freetalk/geometry/surface.h"
#include "freetalk/mesh/components.h"
#include "freetalk/mesh/normals.h"
#include "freetalk/mesh/weld.h"

namespace freetalk::animation {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;

MatrixXd rows_of(const MatrixXd& vertices, const std::vector<int>& members) {
  MatrixXd points(members.size(), 3);
  for (size_t i = 0; i < members.size(); ++i) points.row(i) = vertices.row(members[i]);
  return points;
}

Vector3d extent(const MatrixXd& points) {
  return points.colwise().maxCoeff() - points.colwise().minCoeff();
}

struct Sphere {
  Vector3d centre;
  double radius;
};

/// Least squares |p|^2 = 2 c.p + k; nothing unless the points lie within 8 % of a sphere of an
/// eyeball's size and reach around it in all directions.
std::optional<Sphere> fit_eyeball(const MatrixXd& points) {
  const Vector3d size = extent(points);
  if (points.rows() < 12 || size.minCoeff() < 0.6 * size.maxCoeff()) return std::nullopt;
  const Eigen::RowVector3d mean = points.colwise().mean();
  const MatrixXd centred = points.rowwise() - mean;
  MatrixXd system(points.rows(), 4);
  system << 2 * centred, Eigen::VectorXd::Ones(points.rows());
  const Eigen::VectorXd squares = centred.rowwise().squaredNorm();
  const Eigen::Vector4d solution =
      (system.transpose() * system).ldlt().solve(system.transpose() * squares);
  const Vector3d centre = solution.head<3>();
  const double radius = std::sqrt(std::max(0.0, solution[3] + centre.squaredNorm()));
  if (radius < 0.008 || radius > 0.018) return std::nullopt;
  const Eigen::VectorXd distances = (centred.rowwise() - centre.transpose()).rowwise().norm();
  const double residual = std::sqrt((distances.array() - radius).square().mean());
  if (residual > 0.08 * radius) return std::nullopt;
  return Sphere{centre + mean.transpose(), radius};
}

/// Round, and wholly inside an eyeball: iris, pupil, lens, cornea.
bool is_inside(const MatrixXd& points, const Sphere& eye) {
  const Vector3d size = extent(points);
  if (std::min(size.x(), size.y()) < 0.75 * std::max(size.x(), size.y())) return false;
  const double reach = (points.rowwise() - eye.centre.transpose()).rowwise().norm().maxCoeff();
  return reach < 1.12 * eye.radius;
}

/// The oral cavity relative to the template's lips.
class Mouth {
 public:
  explicit Mouth(const MatrixXd& landmarks) {
    inner_ = landmarks.middleRows(60, 8).colwise().mean();
    front_z_ = 0.5 * (landmarks(51, 2) + landmarks(57, 2));
    half_width_ = 0.5 * std::abs(landmarks(54, 0) - landmarks(48, 0));
    bend_ = (front_z_ - 0.5 * (landmarks(48, 2) + landmarks(54, 2))) / (half_width_ * half_width_);
  }

  bool holds(const MatrixXd& points) const {
    const Vector3d size = extent(points);
    const Vector3d centre = points.colwise().mean().transpose() - inner_;
    if (size.x() > 0.095 || size.maxCoeff() > 0.12) return false;
    if (std::abs(centre.x()) > 1.5 * half_width_ || centre.y() < -0.045 || centre.y() > 0.04 ||
        centre.z() < -0.10) {
      return false;
    }
    const Eigen::ArrayXd front = front_z_ - bend_ * (points.col(0).array() - inner_.x()).square();
    return (points.col(2).array() - front).mean() < -0.005;  // behind the lips, not on them
  }

  /// Height above the occlusal plane, which rises towards the back by 0.15 (mean ICT FaceKit face).
  double height(const Vector3d& point) const {
    return point.y() - (inner_.y() - 0.0035 + 0.15 * (inner_.z() - point.z()));
  }

  double mean_height(const MatrixXd& points) const {
    double sum = 0;
    for (int64_t i = 0; i < points.rows(); ++i) sum += height(points.row(i));
    return sum / static_cast<double>(points.rows());
  }

  /// Whether a good part lies clearly above the plane and a good part clearly below.
  bool spans(const MatrixXd& points) const {
    int64_t above = 0, below = 0;
    for (int64_t i = 0; i < points.rows(); ++i) {
      const double h = height(points.row(i));
      above += h > kClear;
      below += h < -kClear;
    }
    return 5 * above > points.rows() && 5 * below > points.rows();
  }

  /// 1 in front of the throat, 0 from its back wall on: the wall does not follow the jaw.
  double before_throat(const Vector3d& point) const {
    return std::clamp((point.z() - inner_.z() + 0.078) / 0.012, 0.0, 1.0);
  }

  static constexpr double kClear = 0.004;  // m off the plane

 private:
  Vector3d inner_;
  double front_z_, half_width_, bend_;
};

/// The height that divides the parts' mean heights best into two groups (Otsu), within 8 mm of the
/// plane.
double dividing_height(std::vector<double> heights) {
  std::sort(heights.begin(), heights.end());
  double best = 0, best_gap = 0;
  for (size_t i = 0; i + 1 < heights.size(); ++i) {
    const double middle = 0.5 * (heights[i] + heights[i + 1]), gap = heights[i + 1] - heights[i];
    if (std::abs(middle) < 0.008 && gap > best_gap) {
      best = middle;
      best_gap = gap;
    }
  }
  return best_gap > 0.003 ? best : 0;
}

std::vector<double> component_areas(const MatrixXd& vertices, const Welded& welded) {
  const auto areas = mesh::face_areas(vertices, welded.faces);
  std::vector<double> sums(welded.num_components, 0.0);
  for (int64_t f = 0; f < welded.faces.rows(); ++f) {
    sums[welded.component[welded.faces(f, 0)]] += areas[f];
  }
  return sums;
}

/// Components that hold the vertex nearest to some landmark, among those not yet told.
std::vector<bool> landmark_hosts(const MatrixXd& vertices, const Welded& welded,
                                 const std::vector<bool>& excluded, const MatrixXd& landmarks) {
  std::vector<bool> hosts(welded.num_components, false);
  for (int64_t l = 0; l < landmarks.rows(); ++l) {
    double nearest = 0.03 * 0.03;
    int component = -1;
    for (int64_t v = 0; v < vertices.rows(); ++v) {
      if (excluded[welded.component[v]]) continue;
      const double distance = (vertices.row(v) - landmarks.row(l)).squaredNorm();
      if (distance < nearest) {
        nearest = distance;
        component = welded.component[v];
      }
    }
    if (component >= 0) hosts[component] = true;
  }
  return hosts;
}

}  // namespace

Welded weld_seams(const MatrixXd& vertices, const Eigen::MatrixXi& faces) {
  Welded welded;
  const auto same = mesh::first_of_same(vertices, faces, {.min_cosine = 0.5, .on_borders = true});
  welded.representative.assign(same.begin(), same.end());
  welded.faces = faces.unaryExpr([&](int v) { return welded.representative[v]; });
  const auto labels = mesh::connected_components(vertices.rows(), welded.faces);
  std::map<int, int> order;
  welded.component.resize(vertices.rows());
  for (int64_t v = 0; v < vertices.rows(); ++v) {
    const int label = labels[welded.representative[v]];
    welded.component[v] = order.try_emplace(label, static_cast<int>(order.size())).first->second;
  }
  welded.num_components = static_cast<int>(order.size());
  return welded;
}

std::vector<std::vector<int>> component_members(const Welded& welded) {
  std::vector<std::vector<int>> members(welded.num_components);
  for (size_t v = 0; v < welded.component.size(); ++v) {
    members[welded.component[v]].push_back(static_cast<int>(v));
  }
  return members;
}

std::vector<PartMotion> classify_parts(const MatrixXd& vertices, const Welded& welded,
                                       const MatrixXd& landmarks) {
  const auto members = component_members(welded);
  const auto areas = component_areas(vertices, welded);
  const int largest =
      static_cast<int>(std::max_element(areas.begin(), areas.end()) - areas.begin());
  const std::array<Vector3d, 2> eyes = {landmarks.middleRows(36, 6).colwise().mean().transpose(),
                                        landmarks.middleRows(42, 6).colwise().mean().transpose()};
  const Mouth mouth(landmarks);
  std::vector<PartMotion> motions(welded.num_components, PartMotion::kSurface);
  std::vector<bool> told(welded.num_components, false);
  std::vector<Sphere> eyeballs;
  std::vector<std::pair<int, double>> in_mouth;
  for (int c = 0; c < welded.num_components; ++c) {
    if (c == largest || areas[c] <= 0) continue;
    const MatrixXd points = rows_of(vertices, members[c]);
    const auto sphere = fit_eyeball(points);
    if (sphere &&
        std::min((sphere->centre - eyes[0]).norm(), (sphere->centre - eyes[1]).norm()) < 0.018) {
      eyeballs.push_back(*sphere);
      motions[c] = PartMotion::kStill;
      told[c] = true;
    } else if (mouth.holds(points)) {
      motions[c] = PartMotion::kJaw;
      told[c] = true;
      if (!mouth.spans(points)) in_mouth.emplace_back(c, mouth.mean_height(points));
    }
  }
  std::vector<double> heights;
  for (const auto& [c, height] : in_mouth) heights.push_back(height);
  const double divide = dividing_height(heights);
  for (const auto& [c, height] : in_mouth) {
    if (height > divide) motions[c] = PartMotion::kStill;
  }
  const auto hosts = landmark_hosts(vertices, welded, told, landmarks);
  double largest_host = 0;
  for (int c = 0; c < welded.num_components; ++c) {
    if (hosts[c]) largest_host = std::max(largest_host, areas[c]);
  }
  for (int c = 0; c < welded.num_components; ++c) {
    if (told[c]) continue;
    const MatrixXd points = rows_of(vertices, members[c]);
    if (std::any_of(eyeballs.begin(), eyeballs.end(),
                    [&](const Sphere& eye) { return is_inside(points, eye); })) {
      motions[c] = PartMotion::kStill;
    } else if ((hosts[c] && areas[c] >= 0.03 * largest_host) ||
               (largest_host == 0 && c == largest)) {
      motions[c] = PartMotion::kFace;
    }
  }
  return motions;
}

std::vector<float> jaw_shares(const MatrixXd& vertices, const Welded& welded,
                              const std::vector<PartMotion>& motions, const MatrixXd& landmarks) {
  const Mouth mouth(landmarks);
  const auto members = component_members(welded);
  std::vector<float> shares(vertices.rows(), 0.0f);
  std::vector<bool> open(vertices.rows(), false);  // between the jaws: decided by the neighbours
  for (int c = 0; c < welded.num_components; ++c) {
    if (motions[c] != PartMotion::kJaw) continue;
    const bool spans = mouth.spans(rows_of(vertices, members[c]));
    for (const int v : members[c]) {
      const double height = mouth.height(vertices.row(v)),
                   before = mouth.before_throat(vertices.row(v));
      shares[v] = !spans || (height < -Mouth::kClear && before > 0) ? 1.0f : 0.0f;
      open[v] = spans && before > 0 && height <= Mouth::kClear &&
                (height >= -Mouth::kClear || before < 1);
      if (open[v]) shares[v] = 0.5f;
    }
  }
  std::vector<std::vector<int>> neighbours(vertices.rows());
  for (int64_t f = 0; f < welded.faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const int a = welded.faces(f, k), b = welded.faces(f, (k + 1) % 3);
      if (open[a]) neighbours[a].push_back(b);
      if (open[b]) neighbours[b].push_back(a);
    }
  }
  for (int sweep = 0; sweep < 200; ++sweep) {  // Gauss-Seidel on the graph's Laplace equation
    for (size_t v = 0; v < neighbours.size(); ++v) {
      if (neighbours[v].empty()) continue;
      float sum = 0;
      for (const int u : neighbours[v]) sum += shares[u];
      shares[v] = sum / static_cast<float>(neighbours[v].size());
    }
  }
  for (size_t v = 0; v < shares.size(); ++v) shares[v] = shares[welded.representative[v]];
  return shares;
}

}  // namespace freetalk::animation
