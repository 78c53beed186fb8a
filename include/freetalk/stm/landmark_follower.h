// STM's output made to follow its landmarks where they are on the mesh.
//
// What the decoder D does at the landmarks' places x_i differs from the motion dl_i that it was
// told wherever a face moves unlike those of the training. The difference is spread over the
// surface (regression kriging, geometry/kriging.h) and the whole fades out away from the landmarks:
//   d(v) = reach(v) [D(v) + sum_i weights(v, i) (dl_i - D(x_i))]
// Detail of D that is much finer than the way to the nearest landmark is nothing that the landmarks
// tell, and a network's is rougher than a face's: it is taken out first (geometry/low_pass.h).
// All is linear in D and dl, so that a network can be trained through it.
#pragma once

#include <ATen/core/Tensor.h>
#include <c10/core/Device.h>
#include <Eigen/Core>

#include <optional>

#include "freetalk/geometry/kriging.h"
#include "freetalk/geometry/low_pass.h"

namespace freetalk::stm {

struct FollowOptions {
  geometry::KrigingOptions kriging;  // of the difference; range in metres
  double farthest = 0.012;  // m: a landmark farther from the surface than this is not followed
  double detail = 0.25;     // length of the low-pass, share of the way to the nearest landmark;
  double coarsest = 0.006;  // m: but no longer than this, and
  double finest = 0.002;    // m: no shorter. 0 for all three keeps the network's detail
  double near = 0.07;       // m: motion is whole nearer to a landmark than this,
  double far = 0.12;        // m: and none beyond this
  bool guessed = false;     // landmarks are where another face has them: eyes are looked for
  template <class V>
  void fields(V& v) {
    kriging.fields(v);
    v("farthest", farthest);
    v("detail", detail);
    v("coarsest", coarsest);
    v("finest", finest);
    v("near", near);
    v("far", far);
    v("guessed", guessed);
  }
  /// @throws std::invalid_argument naming the option at fault.
  void check() const;
};

/// What following needs of a mesh, computed once; immutable.
class LandmarkFollower {
 public:
  /// @param vertices (V, 3) m, canonical frame. @param faces (F, 3).
  /// @param landmarks (68, 3) m: where they are, on the surface or near it.
  /// @param normals (68, 3) outward there, zero where unknown (see geometry::nearest_on_surface).
  /// @throws std::invalid_argument for other shapes.
  LandmarkFollower(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                   const Eigen::MatrixXd& landmarks, const Eigen::MatrixXd& normals,
                   const FollowOptions& options = {});

  /// @param displacements (T, V, 3) of the decoder, m. @param landmarks (T, 68, 3), m.
  /// @returns (T, V, 3); differentiable.
  at::Tensor apply(const at::Tensor& displacements, const at::Tensor& landmarks) const;

  /// As apply(), each frame by itself, over the threads: its bits depend on no other frame.
  at::Tensor apply_frames(const at::Tensor& displacements, const at::Tensor& landmarks) const;

  /// Adds reach weights differences to displacements (T, V, 3), m, in place: how the surface
  /// follows landmarks that are elsewhere by differences (T, 68, 3), m, than where it has them.
  void add(const at::Tensor& displacements, const at::Tensor& differences) const;

  /// A copy on a device.
  LandmarkFollower to(const c10::Device& device) const;

  int64_t num_followed() const { return num_followed_; }
  const at::Tensor& corners() const { return corners_; }  ///< (68, 3) int64 vertices
  const at::Tensor& shares() const { return shares_; }    ///< (68, 3) barycentric on them
  const at::Tensor& weights() const { return weights_; }  ///< (V, 68); 0 for what is not followed
  const at::Tensor& reach() const { return reach_; }      ///< (V, 1) in [0, 1]
  const at::Tensor& lengths() const { return lengths_; }  ///< (V, 1) of the low-pass, m

 private:
  at::Tensor corners_, shares_, weights_, reach_, lengths_;
  std::optional<geometry::SurfaceLowPass> low_pass_;
  int64_t num_followed_ = 0;
};

}  // namespace freetalk::stm
