// What a Face holds.
#pragma once

#include <ATen/core/Tensor.h>
#include <c10/core/Device.h>

#include <memory>
#include <mutex>

#include "freetalk/animation/parts.h"
#include "freetalk/rig/face_rig.h"
#include "freetalk/stm/landmark_carrier.h"
#include "freetalk/stm/landmark_decoder.h"
#include "freetalk/stm/landmark_follower.h"
#include "freetalk/talker/face.h"
#include "freetalk/talker/models.h"
#include "stages.h"

namespace freetalk::talker {

/// (N, C) float32. @param matrix (N, C).
at::Tensor to_tensor(const Eigen::MatrixXd& matrix, const c10::Device& device);

struct Face::State {
  std::shared_ptr<const TalkerModels> models;
  c10::Device device = c10::kCPU;
  mesh::Mesh mesh;
  FaceOptions options;
  Report report;
  animation::MeshFrame frame;
  at::Tensor rest;     // (V, 3) float32 vertices
  at::Tensor to_mesh;  // (3, 3) float32: rows of displacements in metres to the mesh's own unit
  std::unique_ptr<const animation::Parts> parts;
  std::shared_ptr<const stm::LandmarkFollower> follower;  // null: landmarks are not followed
  std::unique_ptr<const stm::LandmarkCarrier> carrier;    // with the follower
  std::unique_ptr<const stm::LandmarkDecoder> decoder;
  struct LazyRig {
    std::once_flag once;
    std::unique_ptr<const rig::FaceRig> made;
  };
  std::unique_ptr<LazyRig> lazy_rig;

  /// See Face::rig.
  const rig::FaceRig& rig(const std::function<void(double)>& progress) const;

  /// @throws as Talker::prepare.
  static std::shared_ptr<const State> prepare(std::shared_ptr<const TalkerModels> models,
                                              c10::Device device, const mesh::Mesh& mesh,
                                              const FaceOptions& options, const Progress& progress,
                                              const Eigen::MatrixXd& landmarks);

  /// @throws as Talker::prepare_head.
  static std::shared_ptr<const State> of_head(std::shared_ptr<const TalkerModels> models,
                                              const at::Tensor& z_id, int64_t resolution,
                                              const FaceOptions& options, const Progress& progress);

  /// Operators, features and decoder of STM. @param landmarks (68, 3) m, canonical frame.
  /// @param known whether they are the face's own rather than the mean face's.
  void decode_by_stm(const Eigen::MatrixXd& landmarks, bool known, Stages& stages);

  /// Makes the follower, as options.follow_landmarks asks for, where enough of the
  /// landmarks are near the surface. @param usually what "auto" means. Else as decode_by_stm.
  void follow(const Eigen::MatrixXd& landmarks, bool known, bool usually, const c10::Device& where);

  /// The motion of the mean face's landmarks (t, 68, 3), m, as this face makes it.
  at::Tensor carried(const at::Tensor& landmarks) const {
    return carrier ? carrier->apply(landmarks) : landmarks;
  }
  /// Displacements of the mesh, its own unit, from those of the skin. @param skin (t, Vf, 3) m.
  /// @param landmarks (t, 68, 3) m, CPU. @returns (t, V, 3) float32.
  at::Tensor in_mesh(const at::Tensor& skin, const at::Tensor& landmarks) const;
  /// Rigid motion (T, 4, 4) float64 of the canonical frame, m, as that of the mesh, its own unit
  /// and axes.
  at::Tensor in_mesh(const at::Tensor& head) const;
};

}  // namespace freetalk::talker
