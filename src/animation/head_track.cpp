#include "head_track.h"

#include <ATen/ATen.h>
#include <Eigen/Geometry>

namespace freetalk::animation {
namespace {

using HeadMatrix = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

}  // namespace

HeadTrack head_track(const at::Tensor& head, const MeshFrame& frame) {
  const int64_t frames = head.size(0);
  HeadTrack track{at::empty({frames, 4}), at::empty({frames, 3})};
  const Eigen::Matrix3d& up = frame.to_y_up;
  Eigen::Vector4d before = Eigen::Quaterniond::Identity().coeffs();
  for (int64_t t = 0; t < frames; ++t) {
    const HeadMatrix pose = Eigen::Map<const HeadMatrix>(head.const_data_ptr<double>() + 16 * t);
    const Eigen::Matrix3d turn = up * pose.topLeftCorner<3, 3>() * up.transpose();
    Eigen::Vector4d coefficients = Eigen::Quaterniond(turn).coeffs();
    if (coefficients.dot(before) < 0) coefficients = -coefficients;  // the same turn, the short way
    before = coefficients;
    Eigen::Map<Eigen::Vector4f>(track.turns.data_ptr<float>() + 4 * t) = coefficients.cast<float>();
    const Eigen::Vector3d shift = frame.metres_per_unit * (up * pose.topRightCorner<3, 1>());
    Eigen::Map<Eigen::Vector3f>(track.shifts.data_ptr<float>() + 3 * t) = shift.cast<float>();
  }
  return track;
}

at::Tensor head_pose(const double* turn, const double* shift) {
  const at::Tensor result = at::empty({4, 4}, at::kDouble);
  Eigen::Map<HeadMatrix> pose(result.data_ptr<double>());
  pose.setIdentity();
  const Eigen::Quaterniond quaternion(turn[3], turn[0], turn[1], turn[2]);
  pose.topLeftCorner<3, 3>() = quaternion.normalized().toRotationMatrix();
  pose.topRightCorner<3, 1>() = Eigen::Map<const Eigen::Vector3d>(shift);
  return result;
}

}  // namespace freetalk::animation
