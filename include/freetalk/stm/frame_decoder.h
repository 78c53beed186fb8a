// STM's decoder for inference: many frames of one mesh, what depends on the mesh prepared once.
#pragma once

#include <functional>
#include <memory>

#include "freetalk/stm/landmark_decoder.h"
#include "freetalk/stm/landmark_follower.h"
#include "freetalk/stm/stm.h"

namespace freetalk::nn {
class FusedDiffusion;
}

namespace freetalk::stm {

/// decode() without gradients, following the landmarks where it is told how. DiffusionNet decoders
/// in float32 on a CPU go through fused kernels (nn/fused_diffusion.h), others through
/// StmImpl::decode in chunks. Decoding may run on several threads at a time. Through the fused
/// kernels a frame's bits depend on nothing but the frame.
class FrameDecoder : public LandmarkDecoder {
 public:
  /// Changes of the model after this may or may not reach the decoder: make another.
  /// @param follower of the same mesh: displacements follow the landmarks; none: as decode() gives
  /// them.
  FrameDecoder(std::shared_ptr<StmImpl> model, const MeshFeatures& mesh,
               const geometry::SurfaceOperators& operators, const DecodeOptions& options = {},
               std::shared_ptr<const LandmarkFollower> follower = nullptr);
  ~FrameDecoder() override;

  /// A GPU goes on with the next frames while the sink has these.
  void decode(const at::Tensor& landmarks,
              const std::function<void(int64_t, const at::Tensor&)>& sink) const override;
  at::Tensor decode(const at::Tensor& landmarks) const override;
  /// By a decoder of its own.
  at::Tensor decode_once(const at::Tensor& landmarks) const override;

  /// The fastest decoder of this mesh on this processor: in bfloat16 where it multiplies that,
  /// made when it is first asked for; else this one.
  const FrameDecoder& fastest() const override;
  const LandmarkFollower* follower() const override { return follower_.get(); }

 private:
  /// Frames of a chunk, and how many of them are in work at a time: as many as the memory and the
  /// threads of this moment allow.
  struct Plan {
    int64_t chunk, in_work;
  };
  Plan plan() const;
  /// The network laid out for this mesh, on a CPU, made when it is first needed; null where it
  /// cannot be.
  const nn::FusedDiffusion* fused() const;
  at::Tensor decode_chunk(const at::Tensor& landmarks, int64_t in_work) const;
  void each_chunk(const at::Tensor& landmarks,
                  const std::function<void(int64_t, const at::Tensor&)>& use) const;
  /// What the decoder takes in, each frame by itself: its bits do not depend on the others.
  FrameInputs inputs_of(const at::Tensor& landmarks) const;

  std::shared_ptr<StmImpl> model_;
  MeshFeatures mesh_;
  geometry::SurfaceOperators operators_;
  DecodeOptions options_;
  std::shared_ptr<const LandmarkFollower> follower_;
  bool can_fuse_ = false;
  struct Made;
  std::unique_ptr<Made> made_;
};

}  // namespace freetalk::stm
