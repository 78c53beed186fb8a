// Landmark motion made for the mean face, carried to the proportions of another.
//
// What touches in the motion touches on the face. A pair of landmarks that face each other (inner
// lips, lids) has on the face a clearance s >= 0 at rest: how far its two sides are apart, measured
// on the surface. With the vertical opening o of the pair in the motion,
//   lips   o' = max(o - (s + c) w(o), -s - p),  w = 1 up to c, 0 from c + r, smooth between
//   lids   o' = s q,  q = o / s_mean; near -1 smoothly led to -1 and a trace beyond, along the line
//          between the lids of the face instead of that of the mean face: so far that the rims meet
//          on the decoded surface, in the planes of their landmarks and between them
// so that lips whose motion is within c of the neutral face's meet, whatever their clearance, wider
// openings stay, and no lip passes the other by more than p; lids close as far as the eye is open.
// Lips of which more is to be closed than kUpperMost each do so with the lower one and the chin.
// The sideways motion of the mouth goes with its width where the landmarks are known.
#pragma once

#include <ATen/core/Tensor.h>
#include <Eigen/Core>

#include <array>
#include <vector>

#include "freetalk/core/conventions.h"
#include "freetalk/stm/landmark_decoder.h"
#include "freetalk/stm/landmark_follower.h"

namespace freetalk::stm {

/// Immutable; frames are independent of each other, so that streams and clips are the same.
class LandmarkCarrier {
 public:
  /// @param vertices (V, 3) m, canonical frame. @param faces (F, 3). @param follower of this
  /// surface. @param mean (68, 3) m: the landmarks of the mean face.
  /// @param known whether the follower's landmarks are the face's own.
  /// @param decoder of this surface, by which closed lids are seen to meet; none: they meet where
  /// their landmarks do.
  /// @throws std::invalid_argument for other shapes.
  LandmarkCarrier(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                  const LandmarkFollower& follower, const Eigen::MatrixXd& mean, bool known,
                  const LandmarkDecoder* decoder = nullptr);

  /// @param landmarks (T, 68, 3) displacements, m. @returns the same on the CPU.
  at::Tensor apply(const at::Tensor& landmarks) const;

  /// m, of core::kInnerLips; 0 where they are one closed skin.
  const std::array<double, 3>& lip_clearance() const { return lips_; }
  /// m, of core::kLids; that of the mean face where it can't be told.
  const std::array<double, 4>& lid_clearance() const { return lids_; }

 private:
  class Rims;
  /// Makes lids meet on the surface as it is decoded. @param at of the pairs of landmarks.
  /// @param between of the middle of each eye.
  void close_lids(const LandmarkDecoder& decoder, const std::vector<Rims>& at,
                  const std::vector<Rims>& between);

  std::array<double, 3> lips_{};
  std::array<double, 4> lids_{},
      lid_press_{};  // press: m that closed lids go beyond their landmarks
  std::array<Eigen::Vector3d, 4> own_gap_, mean_gap_;  // from lower to upper lid
  double width_ = 1.0;
};

}  // namespace freetalk::stm
