#include "freetalk/animation/jaw.h"

#include <ATen/ATen.h>
#include <Eigen/Cholesky>
#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>

#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"

namespace freetalk::animation {
namespace {

constexpr int kFirst = 5, kCount = 7;  // landmarks 5 ... 11: the chin and the jaw beside it
constexpr double kOpenShare[kCount] = {0.50, 0.69, 0.81, 0.83, 0.81, 0.69, 0.50};   // g
constexpr double kSlideShare[kCount] = {0.90, 1.00, 1.15, 1.20, 1.15, 1.00, 0.90};  // h
constexpr double kWeight[kCount] = {0.3, 1, 1, 1, 1, 1, 0.3};
const Eigen::Vector3d kJoint(0.0, -0.003, -0.076);  // m, between the jaw joints
constexpr double kYawPerMetre = 4.8;                // swing of a sideways slide, rad/m
constexpr double kHuber = 0.002;                    // m
constexpr double kSlidePrior = 0.2;                 // the jaw opens more readily than it slides
constexpr double kMinOpen = -0.017, kMaxOpen = 0.70, kMaxSlide = 0.015;

using Pose = Eigen::Vector3d;  // theta, x, z

Eigen::Vector3d opened(const Eigen::Vector3d& point, double theta) {
  return Eigen::AngleAxisd(theta, Eigen::Vector3d::UnitX()) * (point - kJoint) + kJoint - point;
}

/// What a slide does to a point: the shift and the swing that comes with it.
Eigen::Vector3d slid(const Eigen::Vector3d& point, double x, double z) {
  const double yaw = kYawPerMetre * x;
  return Eigen::Vector3d(x + yaw * (point.z() - kJoint.z()), 0, z - yaw * point.x()) -
         Eigen::Vector3d(yaw * -kJoint.z(), 0, 0);
}

Eigen::Vector3d skin(const Eigen::Vector3d& point, const Pose& pose, int i) {
  return kOpenShare[i] * opened(point, pose[0]) + kSlideShare[i] * slid(point, pose[1], pose[2]);
}

Pose clamped(Pose pose) {
  pose[0] = std::clamp(pose[0], kMinOpen, kMaxOpen);
  pose[1] = std::clamp(pose[1], -kMaxSlide, kMaxSlide);
  pose[2] = std::clamp(pose[2], -kMaxSlide, kMaxSlide);
  return pose;
}

/// Gauss-Newton with Huber weights from a start pose.
Pose fit_pose(const Eigen::MatrixXd& rest, const Eigen::Matrix<double, kCount, 3>& moved,
              Pose pose) {
  constexpr double kStep = 1e-6;
  for (int iteration = 0; iteration < 12; ++iteration) {
    Eigen::Matrix3d normal = Eigen::Vector3d(1e-6, kSlidePrior, kSlidePrior).asDiagonal();
    Eigen::Vector3d right = -normal * pose;
    for (int i = 0; i < kCount; ++i) {
      const Eigen::Vector3d point = rest.row(kFirst + i);
      const Eigen::Vector3d predicted = skin(point, pose, i);
      const Eigen::Vector3d residual = predicted - moved.row(i).transpose();
      Eigen::Matrix3d jacobian;
      for (int k = 0; k < 3; ++k) {
        jacobian.col(k) = (skin(point, pose + kStep * Pose::Unit(k), i) - predicted) / kStep;
      }
      const double weight = kWeight[i] * std::min(1.0, kHuber / std::max(residual.norm(), 1e-9));
      normal += weight * jacobian.transpose() * jacobian;
      right -= weight * jacobian.transpose() * residual;
    }
    const Pose step = normal.ldlt().solve(right);
    pose = clamped(pose + step);
    if (step.cwiseAbs().maxCoeff() < 1e-7) break;
  }
  return pose;
}

RigidMotion motion_of(const Pose& pose) {
  RigidMotion motion;
  const double yaw = kYawPerMetre * pose[1];
  motion.rotation = Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitY()) *
                    Eigen::AngleAxisd(pose[0], Eigen::Vector3d::UnitX());
  // The joint's midpoint goes where the slide takes it.
  motion.translation = kJoint + slid(kJoint, pose[1], pose[2]) - motion.rotation * kJoint;
  return motion;
}

}  // namespace

std::vector<RigidMotion> fit_jaw(const Eigen::MatrixXd& rest_landmarks,
                                 const at::Tensor& displacements) {
  FREETALK_CHECK(rest_landmarks.rows() == core::kNumLandmarks && rest_landmarks.cols() == 3,
                 "fit_jaw: rest landmarks must be (68, 3)");
  FREETALK_CHECK(displacements.dim() == 3 && displacements.size(1) == core::kNumLandmarks &&
                     displacements.size(2) == 3,
                 "fit_jaw: displacements must be (T, 68, 3), found ", displacements.sizes());
  const auto chin =
      displacements.slice(1, kFirst, kFirst + kCount).to(at::kCPU, at::kDouble).contiguous();
  std::vector<RigidMotion> motions;
  using Rows = Eigen::Matrix<double, kCount, 3, Eigen::RowMajor>;
  for (int64_t t = 0; t < chin.size(0); ++t) {
    const Eigen::Matrix<double, kCount, 3> moved =
        Eigen::Map<const Rows>(chin.data_ptr<double>() + t * kCount * 3);
    motions.push_back(motion_of(fit_pose(rest_landmarks, moved, Pose::Zero())));
  }
  return motions;
}

}  // namespace freetalk::animation
