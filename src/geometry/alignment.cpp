#include "freetalk/geometry/alignment.h"

#include <Eigen/Geometry>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <vector>

#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "freetalk/geometry/surface.h"
#include "freetalk/mesh/components.h"
#include "freetalk/mesh/normals.h"
#include "mesh/kd_tree.h"
#include "similarity_icp.h"

namespace freetalk::geometry {
namespace {

using core::kUnits;
using core::Unit;
constexpr std::array<const char*, 6> kAxes{"+x", "-x", "+y", "-y", "+z", "-z"};

Eigen::Vector3d axis_vector(const std::string& axis) {
  return (axis[0] == '-' ? -1.0 : 1.0) * Eigen::Vector3d::Unit(axis[1] - 'x');
}

/// @param taken an axis that is another's, "+x" say, or "auto".
std::string nearest_axis(Eigen::Vector3d direction, const std::string& taken) {
  if (taken != "auto") direction[taken[1] - 'x'] = 0.0;
  int axis = 0;
  direction.cwiseAbs().maxCoeff(&axis);
  return std::string(direction[axis] < 0.0 ? "-" : "+") + static_cast<char>('x' + axis);
}

bool one_of(const std::string& value, const auto& names) {
  return std::find(names.begin(), names.end(), value) != names.end();
}

/// Rotations that bring `up` to +Y and `forward` to +Z, over the axes the options leave open.
std::vector<Eigen::Matrix3d> orientations(const AlignOptions& options) {
  std::vector<Eigen::Matrix3d> result;
  for (const char* up : kAxes) {
    for (const char* forward : kAxes) {
      if (up[1] == forward[1]) continue;
      if (options.up != "auto" && options.up != up) continue;
      if (options.forward != "auto" && options.forward != forward) continue;
      Eigen::Matrix3d& rotation = result.emplace_back();
      rotation.row(1) = axis_vector(up);
      rotation.row(2) = axis_vector(forward);
      rotation.row(0) = axis_vector(up).cross(axis_vector(forward));
    }
  }
  return result;
}

/// The faces of the part with the largest area, parts being connected through equal positions too.
Eigen::MatrixXi largest_part(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces) {
  const Eigen::VectorXi first = mesh::coincident_vertices(vertices);
  Eigen::MatrixXi welded = faces;
  for (Eigen::Index i = 0; i < welded.size(); ++i) welded(i) = first[welded(i)];
  const Eigen::VectorXi labels = mesh::connected_components(vertices.rows(), welded);
  const Eigen::VectorXd areas = mesh::face_areas(vertices, faces);
  Eigen::VectorXd area_of = Eigen::VectorXd::Zero(labels.maxCoeff() + 1);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) area_of[labels[welded(f, 0)]] += areas[f];
  int largest = 0;
  const double share = area_of.maxCoeff(&largest) / areas.sum();
  constexpr double kDominant = 0.2;  // A mesh in shreds has no main part: all of it counts.
  if (share < kDominant) return faces;
  std::vector<Eigen::Index> kept;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    if (labels[welded(f, 0)] == largest) kept.push_back(f);
  }
  return faces(kept, Eigen::all);
}

mesh::KdTree make_tree(const SurfaceSamples& samples, double normal_sign) {
  return mesh::KdTree(samples.points.transpose(), normal_sign * samples.normals.transpose());
}

struct Box {
  Eigen::Vector3d low, high;
};

/// Bounds without the outermost hundredth on each side.
Box robust_box(const Eigen::Matrix3Xd& points) {
  Box box;
  std::vector<double> values(static_cast<size_t>(points.cols()));
  for (int axis = 0; axis < 3; ++axis) {
    for (Eigen::Index i = 0; i < points.cols(); ++i)
      values[static_cast<size_t>(i)] = points(axis, i);
    std::sort(values.begin(), values.end());
    box.low[axis] = values[values.size() / 100];
    box.high[axis] = values[values.size() - 1 - values.size() / 100];
  }
  return box;
}

/// The most forward z among points near (x, y).
double front_near(const Eigen::Matrix3Xd& points, double x, double y) {
  double front = -INFINITY, any = -INFINITY;
  for (Eigen::Index i = 0; i < points.cols(); ++i) {
    any = std::max(any, points(2, i));
    const bool near = std::abs(points(0, i) - x) < 0.06 && std::abs(points(1, i) - y) < 0.07;
    if (near) front = std::max(front, points(2, i));
  }
  return std::isfinite(front) ? front : any;
}

/// Starting poses for one orientation and scale: the face somewhere along the height, its front
/// flush.
void add_starts(const Eigen::Matrix3Xd& mesh, const Eigen::Matrix3Xd& target,
                const Eigen::Matrix3d& rotation, double scale, std::vector<Similarity>& out) {
  const Eigen::Matrix3Xd turned = scale * (rotation * mesh);
  const Box box = robust_box(turned);
  const double target_front = front_near(target, 0.0, 0.0);
  const double x = 0.5 * (box.low.x() + box.high.x());
  // Half a face from either end; the template's origin is the middle of the landmarks.
  constexpr double kHalfFace = 0.09, kStep = 0.035;
  constexpr int kMaxStarts = 40;
  double low = box.low.y() + kHalfFace, high = box.high.y() - kHalfFace;
  if (low > high) low = high = 0.5 * (low + high);
  low -= kStep / 2;
  high += kStep / 2;
  const int steps = std::clamp(static_cast<int>(std::ceil((high - low) / kStep)), 1, kMaxStarts);
  for (int i = 0; i <= steps; ++i) {
    const double y = high - (high - low) * i / steps;
    const double z = front_near(turned, x, y) - target_front;
    out.push_back({scale, rotation, Eigen::Vector3d(-x, -y, -z)});
  }
}

struct PoseCandidate {
  Similarity pose;
  double prior = 0.0;  // the scale expected; 0 for none
  double score = 0.0;
};

void keep_best(std::vector<PoseCandidate>& candidates, size_t count) {
  std::sort(candidates.begin(), candidates.end(),
            [](const PoseCandidate& a, const PoseCandidate& b) { return a.score < b.score; });
  if (candidates.size() > count) candidates.resize(count);
}

/// The scales to start from, with what is expected of each: those units in which the mesh has the
/// size of a mask, head, bust or body; without one, sizes between a mask and a bust.
std::vector<std::pair<double, double>> start_scales(const std::string& unit, double extent,
                                                    bool arbitrary) {
  std::vector<std::pair<double, double>> scales;
  constexpr double kSmallest = 0.12, kLargest = 2.3;  // m, the longest side
  for (const Unit& candidate : kUnits) {
    const double size = extent * candidate.metres;
    if (unit == candidate.name) return {{candidate.metres, candidate.metres}};
    if (!arbitrary && size >= kSmallest && size <= kLargest) {
      scales.emplace_back(candidate.metres, candidate.metres);
    }
  }
  if (scales.empty()) {
    for (const double size : {0.18, 0.24, 0.32, 0.45}) scales.emplace_back(size / extent, 0.0);
  }
  return scales;
}

struct Search {
  const mesh::KdTree& coarse;  // the mesh
  const mesh::KdTree& fine;
  const mesh::KdTree& target;
  double target_spacing;
  const AlignOptions& options;

  PoseCandidate run(bool arbitrary) const {
    const Box box = robust_box(coarse.points());
    const double extent = (box.high - box.low).maxCoeff();
    std::vector<PoseCandidate> candidates;
    for (const Eigen::Matrix3d& rotation : orientations(options)) {
      for (const auto& [scale, prior] : start_scales(options.unit, extent, arbitrary)) {
        std::vector<Similarity> starts;
        add_starts(coarse.points(), target.points(), rotation, scale, starts);
        for (const Similarity& start : starts) candidates.push_back({start, prior, 0.0});
      }
    }
    rescore(candidates, coarse, 0.030, 150, 0);
    keep_best(candidates, 96);
    stage(candidates, coarse, {.iterations = 8, .num_target = 200}, 0.020, 24);
    stage(candidates, coarse,
          {.iterations = 12, .reach_begin_m = 0.025, .num_target = 400, .num_source = 400}, 0.015,
          4);
    stage(candidates, fine,
          {.iterations = 25,
           .reach_begin_m = 0.020,
           .reach_end_m = 0.010,
           .num_target = 1000,
           .num_source = 1000},
          0.010, 1);
    return candidates.front();
  }

  IcpProblem problem(const mesh::KdTree& mesh, double prior) const {
    return {mesh, target, target_spacing, prior};
  }

  void rescore(std::vector<PoseCandidate>& candidates, const mesh::KdTree& mesh, double reach_m,
               int num_target, int num_source) const {
    for (PoseCandidate& c : candidates) {
      c.score = fit_score(problem(mesh, c.prior), c.pose, reach_m, num_target, num_source);
    }
  }

  /// Refines all, scores them at `reach_m` and keeps the best `count`.
  void stage(std::vector<PoseCandidate>& candidates, const mesh::KdTree& mesh,
             const IcpSettings& settings, double reach_m, size_t count) const {
    for (PoseCandidate& c : candidates) c.pose = refine(problem(mesh, c.prior), c.pose, settings);
    rescore(candidates, mesh, reach_m, 2 * settings.num_target, settings.num_source);
    keep_best(candidates, count);
  }
};

std::string capital(const std::string& axis) {
  return {axis[0], static_cast<char>(axis[1] - 'a' + 'A')};
}

std::string unit_of(double scale) {
  const Unit* best = nullptr;
  double smallest = std::log(1.35);  // Beyond a third off, no head is that large or small.
  for (const Unit& unit : kUnits) {
    const double deviation = std::abs(std::log(scale / unit.metres));
    if (deviation < smallest) {
      smallest = deviation;
      best = &unit;
    }
  }
  return best != nullptr ? best->name : "arbitrary";
}

struct Fit {
  Similarity pose;
  FitQuality quality{INFINITY, INFINITY};

  /// Residual and angle in one number, each relative to what a face may have.
  double badness() const {
    return quality.residual_m / kFaceResidual + quality.normal_degrees / kFaceDegrees;
  }
};

bool face_like(const FitQuality& quality) {
  return quality.residual_m <= kFaceResidual && quality.normal_degrees <= kFaceDegrees;
}

/// The best fit; with the normals turned around too if the first does not look like a face (wound
/// inside out).
Fit search_both_windings(const SurfaceSamples& coarse_samples, const SurfaceSamples& fine_samples,
                         const mesh::KdTree& target, double spacing, const AlignOptions& options,
                         bool arbitrary) {
  Fit best;
  for (const double normal_sign : {1.0, -1.0}) {
    const mesh::KdTree coarse = make_tree(coarse_samples, normal_sign);
    const mesh::KdTree fine = make_tree(fine_samples, normal_sign);
    Fit fit{Search{coarse, fine, target, spacing, options}.run(arbitrary).pose};
    fit.quality = fit_quality({fine, target, spacing, 0.0}, fit.pose);
    if (fit.badness() < best.badness()) best = fit;
    if (face_like(best.quality)) break;
  }
  return best;
}

Alignment describe(const Fit& found, const AlignOptions& options) {
  const Similarity& fit = found.pose;
  const double residual_m = found.quality.residual_m;
  Alignment result;
  result.to_canonical = fit;
  result.unit = options.unit != "auto" ? options.unit : unit_of(fit.scale);
  result.up = options.up != "auto" ? options.up
                                   : nearest_axis(fit.rotation.row(1).transpose(), options.forward);
  result.forward = options.forward != "auto"
                       ? options.forward
                       : nearest_axis(fit.rotation.row(2).transpose(), result.up);
  result.guessed = options.unit == "auto" || options.up == "auto" || options.forward == "auto";
  result.residual_m = residual_m;
  result.normal_degrees = found.quality.normal_degrees;
  result.face_like = face_like(found.quality);
  char millimetres[32];
  std::snprintf(millimetres, sizeof(millimetres), "%.1f", residual_m * 1e3);
  const bool some = options.unit != "auto" || options.up != "auto" || options.forward != "auto";
  const auto how = [&](const std::string& option) {
    return !(result.guessed && some) ? "" : option == "auto" ? " (guessed)" : " (given)";
  };
  result.summary = core::join(result.guessed && some ? ""
                              : result.guessed       ? "guessed "
                                                     : "given ",
                              "unit ", result.unit, how(options.unit), ", ", capital(result.up),
                              " up", how(options.up), ", ", capital(result.forward), " forward",
                              how(options.forward), "; fit residual ", millimetres, " mm");
  if (!result.face_like) result.summary += " (does not look like a face)";
  return result;
}

}  // namespace

Eigen::MatrixXd Similarity::apply(const Eigen::MatrixXd& points) const {
  return apply_vectors(points).rowwise() + translation.transpose();
}

Eigen::MatrixXd Similarity::apply_vectors(const Eigen::MatrixXd& vectors) const {
  return scale * vectors * rotation.transpose();
}

Similarity Similarity::inverse() const {
  const Eigen::Matrix3d back = rotation.transpose();
  return {1.0 / scale, back, back * translation / -scale};
}

Similarity Similarity::compose(const Similarity& first) const {
  return {scale * first.scale, rotation * first.rotation,
          scale * (rotation * first.translation) + translation};
}

void AlignOptions::check() const {
  const bool known_unit =
      unit == "auto" || std::any_of(kUnits.begin(), kUnits.end(), [this](const Unit& candidate) {
        return unit == candidate.name;
      });
  FREETALK_CHECK(known_unit, "unit must be auto, m, cm, mm or in, found \"", unit, "\"");
  FREETALK_CHECK(up == "auto" || one_of(up, kAxes),
                 "up must be auto, +x, -x, +y, -y, +z or -z, found \"", up, "\"");
  FREETALK_CHECK(forward == "auto" || one_of(forward, kAxes),
                 "forward must be auto, +x, -x, +y, -y, +z or -z, found \"", forward, "\"");
  FREETALK_CHECK(up == "auto" || forward == "auto" || up[1] != forward[1],
                 "up and forward must be different axes, found ", up, " and ", forward);
}

Alignment align_to_template(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                            const Eigen::MatrixXd& template_points,
                            const Eigen::MatrixXd& template_normals, const AlignOptions& options) {
  options.check();
  FREETALK_CHECK(template_points.rows() >= 100 && template_points.cols() == 3 &&
                     template_normals.rows() == template_points.rows() &&
                     template_normals.cols() == 3,
                 "a face template needs at least 100 points with normals, found ",
                 template_points.rows(), " points and ", template_normals.rows(), " normals");
  FREETALK_CHECK(vertices.cols() == 3 && vertices.allFinite() && faces.cols() == 3 &&
                     faces.rows() > 0 && faces.minCoeff() >= 0 &&
                     faces.maxCoeff() < vertices.rows(),
                 "alignment needs finite vertices (V, 3) and triangles (F, 3) within them");
  const mesh::KdTree target(template_points.transpose(), template_normals.transpose());
  const Eigen::MatrixXi part = largest_part(vertices, faces);
  constexpr int64_t kCoarse = 3000, kFine = 16000;
  const SurfaceSamples coarse_samples = sample_surface(vertices, part, kCoarse);
  const SurfaceSamples fine_samples = sample_surface(vertices, part, kFine);
  // Samples of a face of some 0.08 m^2.
  const double spacing = std::sqrt(0.08 / static_cast<double>(template_points.rows()));

  Fit best = search_both_windings(coarse_samples, fine_samples, target, spacing, options, false);
  // No head is this large: perhaps a unit only happens to make it one, or the face is a small part
  // of a body.
  constexpr double kLargestHead = 0.6;
  const double extent =
      (fine_samples.points.colwise().maxCoeff() - fine_samples.points.colwise().minCoeff())
          .maxCoeff();
  const bool doubtful = !face_like(best.quality) || extent * best.pose.scale > kLargestHead;
  if (doubtful && options.unit == "auto") {
    Fit other = search_both_windings(coarse_samples, fine_samples, target, spacing, options, true);
    if (other.badness() < best.badness()) best = other;
  }
  return describe(best, options);
}

}  // namespace freetalk::geometry
