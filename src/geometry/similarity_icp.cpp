#include "similarity_icp.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

namespace freetalk::geometry {
namespace {

constexpr double kMinCosine = 0.5;  // Normals within 60 degrees match.
// A normal off by a radian counts as this far away: points match their like on another nose, eye or
// lip.
constexpr double kNormalLength = 0.01;
constexpr double kAnyCosine = -1.0;  // The angle is what is measured then.
// Identities differ most at the neck, jaw and ears: the fit leans on what is within this of the
// origin.
constexpr double kMiddle = 0.08;

/// A mesh point in the template's frame, and what it should touch.
struct Match {
  Eigen::Vector3d source;
  Eigen::Vector3d target;
  Eigen::Vector3d normal;  // of the template
  Eigen::Vector3d source_normal = Eigen::Vector3d::Zero();
};

/// Evenly spaced indices: the samples are in surface order.
Eigen::Index pick(Eigen::Index i, Eigen::Index used, Eigen::Index count) {
  return i * count / used;
}

/// Calls visit(distance, match) for template points (nothing within reach: distance < 0, no match).
template <class Visit>
void match_target(const IcpProblem& problem, const Similarity& guess, double reach_m, int used,
                  double min_cosine, Visit&& visit) {
  const Eigen::Index count = problem.target.size();
  const Eigen::Index number = std::min<Eigen::Index>(used, count);
  const Similarity inverse = guess.inverse();
  const Eigen::Matrix3d linear = inverse.scale * inverse.rotation;
  for (Eigen::Index i = 0; i < number; ++i) {
    const Eigen::Index t = pick(i, number, count);
    const Eigen::Vector3d target = problem.target.points().col(t);
    const Eigen::Vector3d normal = problem.target.normals().col(t);
    const int found =
        problem.source.nearest(linear * target + inverse.translation, inverse.rotation * normal,
                               reach_m * inverse.scale, min_cosine, kNormalLength * inverse.scale);
    if (found < 0) {
      visit(-1.0, Match{target, target, normal});
      continue;
    }
    const Eigen::Vector3d source =
        guess.scale * (guess.rotation * problem.source.points().col(found)) + guess.translation;
    const Eigen::Vector3d source_normal = guess.rotation * problem.source.normals().col(found);
    // Distance to the mesh's tangent plane, so that the spacing of its samples does not count.
    visit(std::abs(source_normal.dot(target - source)),
          Match{source, target, normal, source_normal});
  }
}

/// Calls visit(distance, match) for mesh points near the template; points beyond its border are
/// skipped.
template <class Visit>
void match_source(const IcpProblem& problem, const Similarity& guess, double reach_m, int used,
                  bool skip_far, Visit&& visit) {
  const Eigen::Index count = problem.source.size();
  const Eigen::Index number = std::min<Eigen::Index>(used, count);
  for (Eigen::Index i = 0; i < number; ++i) {
    const Eigen::Index s = pick(i, number, count);
    const Eigen::Vector3d source =
        guess.scale * (guess.rotation * problem.source.points().col(s)) + guess.translation;
    const Eigen::Vector3d source_normal = guess.rotation * problem.source.normals().col(s);
    const int found =
        problem.target.nearest(source, source_normal, reach_m, kMinCosine, kNormalLength);
    if (found < 0) {
      if (!skip_far) visit(-1.0, Match{});
      continue;
    }
    const Eigen::Vector3d target = problem.target.points().col(found);
    const Eigen::Vector3d normal = problem.target.normals().col(found);
    const double height = normal.dot(source - target);
    const double along = (source - target - height * normal).norm();
    if (along > 2.0 * problem.target_spacing) {  // Beyond the border of the template.
      if (!skip_far) visit(-1.0, Match{});
      continue;
    }
    visit(std::abs(height), Match{source, target, normal});
  }
}

using Matrix7 = Eigen::Matrix<double, 7, 7>;
using Vector7 = Eigen::Matrix<double, 7, 1>;

/// Gauss-Newton on rotation, translation and log scale about `centre`.
struct NormalEquations {
  Matrix7 left = Matrix7::Zero();
  Vector7 right = Vector7::Zero();
  Eigen::Vector3d centre;
  double reach_m;

  void add(const Match& match) {
    // Tangential distances hold the fit where the surface alone lets it slide.
    constexpr double kTangentialWeight = 0.05;
    constexpr double kOuterFalloff = 20.0;
    const Eigen::Vector3d gap = match.target - match.source;
    const double ratio = gap.norm() / reach_m;
    if (ratio >= 1.0) return;
    const double outside = std::max(0.0, match.target.norm() / kMiddle - 1.0);
    const double robust = (1.0 - ratio * ratio) * (1.0 - ratio * ratio);
    const double weight = robust / (1.0 + kOuterFalloff * outside * outside);
    const Eigen::Vector3d arm = match.source - centre;
    add_row(match.normal, arm, gap.dot(match.normal), weight);
    for (int axis = 0; axis < 3; ++axis) {
      add_row(Eigen::Vector3d::Unit(axis), arm, gap[axis], weight * kTangentialWeight);
    }
  }

  void add_row(const Eigen::Vector3d& direction, const Eigen::Vector3d& arm, double gap,
               double weight) {
    Vector7 row;
    row << arm.cross(direction), direction, direction.dot(arm);
    left += weight * row * row.transpose();
    right += weight * gap * row;
  }
};

Similarity step(const NormalEquations& equations) {
  Matrix7 left = equations.left;
  left.diagonal().array() += 1e-9 * left.trace();
  const Vector7 delta = left.ldlt().solve(equations.right);
  Similarity update;
  if (!delta.allFinite()) return update;
  const double angle = delta.head<3>().norm();
  constexpr double kMaxAngle = 0.25,
                   kMaxLogScale = 0.15;  // a step; the linearisation holds no further
  if (angle > 0.0) {
    const Eigen::Vector3d axis = delta.head<3>() / angle;
    update.rotation = Eigen::AngleAxisd(std::min(angle, kMaxAngle), axis).toRotationMatrix();
  }
  update.scale = std::exp(std::clamp(delta[6], -kMaxLogScale, kMaxLogScale));
  update.translation =
      equations.centre + delta.segment<3>(3) - update.scale * (update.rotation * equations.centre);
  return update;
}

double trimmed_mean(std::vector<double>& distances) {
  if (distances.empty()) return 1.0;
  constexpr double kBest = 0.85;
  const auto kept = std::max<size_t>(1, static_cast<size_t>(kBest * distances.size()));
  std::nth_element(distances.begin(), distances.begin() + static_cast<std::ptrdiff_t>(kept) - 1,
                   distances.end());
  double sum = 0.0;
  for (size_t i = 0; i < kept; ++i) sum += distances[i];
  return sum / static_cast<double>(kept);
}

}  // namespace

double fit_score(const IcpProblem& problem, const Similarity& guess, double reach_m, int num_target,
                 int num_source) {
  double target_sum = 0.0, source_sum = 0.0;
  int target_count = 0, source_count = 0;
  const auto cost = [reach_m](double distance) {
    const double ratio = distance < 0.0 ? 1.0 : std::min(1.0, distance / reach_m);
    return ratio * ratio;
  };
  match_target(problem, guess, reach_m, num_target, kMinCosine, [&](double distance, const Match&) {
    target_sum += cost(distance);
    ++target_count;
  });
  match_source(problem, guess, reach_m, num_source, false, [&](double distance, const Match&) {
    source_sum += cost(distance);
    ++source_count;
  });
  double score = target_sum / std::max(1, target_count);
  if (source_count > 0) score = 0.8 * score + 0.2 * source_sum / source_count;
  if (problem.scale_prior > 0.0) {
    const double deviation = std::log(guess.scale / problem.scale_prior) / 0.2;
    score += 0.02 * deviation * deviation;  // Heads of one unit differ by some 10 % in size.
  }
  return score;
}

Similarity refine(const IcpProblem& problem, const Similarity& guess, const IcpSettings& settings) {
  Similarity fit = guess;
  const Eigen::Vector3d centre = problem.target.points().rowwise().mean();
  for (int i = 0; i < settings.iterations; ++i) {
    const double progress = settings.iterations > 1 ? double(i) / (settings.iterations - 1) : 1.0;
    const double reach =
        settings.reach_begin_m * std::pow(settings.reach_end_m / settings.reach_begin_m, progress);
    NormalEquations equations{.centre = centre, .reach_m = reach};
    const auto add = [&equations](double distance, const Match& match) {
      if (distance >= 0.0) equations.add(match);
    };
    match_target(problem, fit, reach, settings.num_target, kMinCosine, add);
    match_source(problem, fit, reach, settings.num_source, true, add);
    fit = step(equations).compose(fit);
  }
  return fit;
}

FitQuality fit_quality(const IcpProblem& problem, const Similarity& fit) {
  constexpr double kReach = 0.025;
  constexpr double kUnmatchedDegrees = 60.0;
  constexpr int kPoints = 3000;
  std::vector<double> distances, degrees;
  match_target(problem, fit, kReach, kPoints, kAnyCosine, [&](double distance, const Match& match) {
    if (match.target.norm() > kMiddle) return;
    const double cosine = std::clamp(match.normal.dot(match.source_normal), -1.0, 1.0);
    distances.push_back(distance < 0.0 ? kReach : distance);
    degrees.push_back(distance < 0.0 ? kUnmatchedDegrees
                                     : std::acos(cosine) * 180.0 / std::numbers::pi);
  });
  return {trimmed_mean(distances), trimmed_mean(degrees)};
}

}  // namespace freetalk::geometry
