// Landmark motion on a surface that a parametric head moves: the landmarks are explained by
// expression weights, which the head turns into its code, and the code moves canonical points.
#pragma once

#include <memory>
#include <mutex>

#include "freetalk/facetalk/facetalk.h"
#include "freetalk/head/prepared_head.h"
#include "freetalk/rig/face_rig.h"
#include "freetalk/stm/landmark_decoder.h"
#include "freetalk/stm/landmark_follower.h"

namespace freetalk::talker {

/// Expression weights of a head from those of ARKit's shapes, by name: "mouthSmile_L" is ARKit's
/// "mouthSmileLeft"; a head that tells sides apart where ARKit does not has the shape on both.
/// @returns (S, num_weights) float32. @throws std::runtime_error for a head without names.
at::Tensor weights_of_shapes(const std::vector<std::string>& shapes,
                             const head::HeadOptions& options);

class HeadDecoder : public stm::LandmarkDecoder {
 public:
  /// @param rig the landmark motion of ARKit's shapes.
  /// @param canonical (V, 3) points in canonical space, metres.
  /// @param share (V,) of its displacement that a point keeps; points of share 0 cost nothing.
  /// @param follower of the mesh whose vertices the points are: their motion is made to follow the
  /// landmarks; none: it is the head's.
  HeadDecoder(const head::PreparedHead& head, const rig::RigPoses& rig, const at::Tensor& canonical,
              const at::Tensor& share,
              std::shared_ptr<const stm::LandmarkFollower> follower = nullptr);
  ~HeadDecoder() override;

  void decode(const at::Tensor& landmarks,
              const std::function<void(int64_t, const at::Tensor&)>& sink) const override;
  at::Tensor decode(const at::Tensor& landmarks) const override;
  const LandmarkDecoder& fastest() const override;
  const stm::LandmarkFollower* follower() const override { return follower_.get(); }

  /// Codes (T, expression_dim) that explain landmarks (T, 68, 3), m.
  at::Tensor codes_of(const at::Tensor& landmarks) const;
  /// Codes of the head from what FaceTalk speaks (T, Z), codes of this head or weights of named
  /// expressions, whose landmarks `spoken` (T, 68, 3) became `landmarks`. Weights stay in [0, 1].
  at::Tensor codes_of(const at::Tensor& codes, const facetalk::FaceTalkOptions& options,
                      const at::Tensor& spoken, const at::Tensor& landmarks) const;
  /// As decode(), of codes (T, expression_dim) that move landmarks (T, 68, 3).
  void decode_codes(const at::Tensor& codes, const at::Tensor& landmarks,
                    const std::function<void(int64_t, const at::Tensor&)>& sink) const;

  const head::PreparedHead& head() const { return head_; }

 private:
  struct Shapes;
  struct Fastest;
  /// Weights (T, num_weights) of the head's expressions that explain landmarks (T, 68, 3), m.
  at::Tensor weights_of(const at::Tensor& landmarks) const;
  /// The same points under other numbers.
  HeadDecoder(const HeadDecoder& other, const head::PreparedHead& head);

  head::PreparedHead head_;
  std::shared_ptr<const Shapes> shapes_;
  int64_t num_points_;
  at::Tensor moving_;             // (M,) points that move
  at::Tensor canonical_, share_;  // (M, 3) head units, (M, 1) metres of a head unit
  at::Tensor posed_;              // (M, 3) at rest, head units
  std::shared_ptr<const stm::LandmarkFollower> follower_;
  std::unique_ptr<Fastest> fastest_;
};

}  // namespace freetalk::talker
