// The rigid motion of the lower jaw behind the moving skin of the chin.
//
// The mandible turns by theta about the axis through both jaw joints and slides by (x, 0, z),
// swinging about the vertical as it goes sideways. Skin follows bone by a share g_i (least far from
// the chin), so that per frame
//
//   min over theta, x, z of  sum_i w_i rho(|g_i (R(theta) p_i - p_i) + h_i s(x, z) - d_i|) + prior
//
// with Huber's rho: lips and chin muscles move the skin while the bone stays. Teeth can't bite
// through each other: theta is kept above -1 degree. Joint position and shares are those of the
// mean ICT FaceKit face.
#pragma once

#include <ATen/core/Tensor.h>
#include <Eigen/Core>

#include <vector>

namespace freetalk::animation {

/// x -> rotation * x + translation.
struct RigidMotion {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
};

/// @param rest_landmarks (68, 3) m, canonical frame. @param displacements (T, 68, 3) float32 m.
/// @return T motions in the canonical frame.
std::vector<RigidMotion> fit_jaw(const Eigen::MatrixXd& rest_landmarks,
                                 const at::Tensor& displacements);

}  // namespace freetalk::animation
