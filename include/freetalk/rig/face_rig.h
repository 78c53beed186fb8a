// A face as a linear rig: named targets and correctives that reproduce STM on one mesh.
//
//   d(l) = sum_i w_i(l) T_i,   0 <= w_i <= 1
//
// The first targets are STM's decoding of the landmark motion of each ARKit shape, so a rig is made
// on any mesh without matching surfaces. Their weights are those of the shapes that explain the
// landmarks (ShapeSolver). What STM does beside comes from decoded poses, between which it is
// interpolated over the landmarks (geometry/greedy_interpolation.h): its principal fields are the
// correctives, each as two targets, one for either sign. Weights are a smooth nonlinear function of
// the landmarks, displacements a linear one of the weights: whatever plays blend shapes plays them.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace freetalk::rig {

/// Landmark motion that rigs are made of; depends on no mesh.
struct RigPoses {
  std::vector<std::string> names;  // of the shapes, ARKit's
  at::Tensor shapes;               // (S, 68, 3) float32 m: each shape at weight one
  at::Tensor library;              // (P, 68, 3) float32 m: poses, the most different first

  /// @throws std::runtime_error naming the file that is missing, broken or does not fit.
  static RigPoses load(const std::filesystem::path& path);
  /// @throws std::invalid_argument for shapes that do not fit each other.
  void check() const;
};

struct RigOptions {
  int64_t num_poses = 100;       // of the library that are decoded, at most
  int64_t max_correctives = 32;  // fields; each gives two targets
  double tolerance_mm = 0.02;    // root mean square of what the correctives leave of the poses
  // Weights of the solver's terms, mm^2 over all landmarks:
  double l2 = 1.0;        // sum of w^2
  double l1 = 0.5;        // sum of w
  double symmetry = 5.0;  // (w_left - w_right)^2
  double cancel = 20.0;   // w_a w_b of shapes that undo each other
  double temporal = 0.0;  // (w - w of the frame before)^2
  std::vector<std::string> disabled = {
      "eyeLookDownLeft", "eyeLookInLeft",   "eyeLookOutLeft", "eyeLookUpLeft", "eyeLookDownRight",
      "eyeLookInRight",  "eyeLookOutRight", "eyeLookUpRight"};  // shapes whose weight stays zero
  template <class V>
  void fields(V& v) {
    v("num_poses", num_poses);
    v("max_correctives", max_correctives);
    v("tolerance_mm", tolerance_mm);
    v("l2", l2);
    v("l1", l1);
    v("symmetry", symmetry);
    v("cancel", cancel);
    v("temporal", temporal);
    v("disabled", disabled);
  }
  /// @throws std::invalid_argument naming the option at fault.
  void check() const;
};

/// What a stream of frames carries from one to the next; empty at its start.
struct SolveState {
  std::vector<double> shapes;  // the last frame's weights
};

/// Immutable; const methods may run on several threads at a time.
class FaceRig {
 public:
  /// (N, 68, 3) float32 landmark displacements, m -> (N, V, 3) float32 vertex displacements, m.
  using Decode = std::function<at::Tensor(const at::Tensor&)>;

  /// Decodes shapes + poses, in batches.
  /// @param progress called with the finished share in [0, 1]; may throw to stop.
  /// @throws std::invalid_argument for poses or options that do not fit; std::runtime_error where
  /// `decode` gives other shapes or values that are not finite.
  static FaceRig build(const Decode& decode, const RigPoses& poses, const RigOptions& options = {},
                       const std::function<void(double)>& progress = {});

  /// The rig that an earlier call left in `cache_dir` (empty: core::default_cache_dir()), or a new
  /// one, left there for the next. A folder that cannot be written, or a damaged file in it, costs
  /// the time and is logged.
  /// @param content says what `decode` computes: a hash of weights and mesh, say.
  static FaceRig cached(const std::string& content, const std::filesystem::path& cache_dir,
                        const Decode& decode, const RigPoses& poses, const RigOptions& options = {},
                        const std::function<void(double)>& progress = {});

  /// @throws std::runtime_error naming the file that is missing, broken or does not fit.
  static FaceRig load(const std::filesystem::path& path);
  void save(const std::filesystem::path& path) const;

  /// ARKit's names, then "corrective_00_plus", "corrective_00_minus", ...
  const std::vector<std::string>& names() const { return names_; }
  int64_t num_shapes() const { return shapes_.size(0); }
  int64_t num_vertices() const { return targets_.size(1); }
  /// (W, V, 3) float32 m.
  const at::Tensor& targets() const { return targets_; }
  const RigOptions& options() const { return options_; }

  /// @param landmarks (T, 68, 3) float32 displacements, m. @param state carries on a stream: the
  /// frames of several calls weigh the same as those of one. @returns (T, W) float32 in [0, 1].
  at::Tensor solve(const at::Tensor& landmarks, SolveState* state = nullptr) const;

  /// @param weights (T, W) float32. @returns (T, V, 3) float32 displacements, m.
  at::Tensor vertices(const at::Tensor& weights) const;

 private:
  struct Solver;
  FaceRig() = default;
  /// Checks that the members fit and makes the solver. @throws std::invalid_argument.
  void prepare();

  std::vector<std::string> names_;
  RigOptions options_;
  at::Tensor targets_;
  at::Tensor shapes_;        // (S, 68, 3) float32 m
  at::Tensor nodes_;         // (N, 68, 3) float32 m: decoded poses, in the order of interpolation
  at::Tensor node_fields_;   // (N, C) float64: the nodes' displacements in the corrective fields
  at::Tensor shape_fields_;  // (S, C) float64: the shape targets in the corrective fields
  at::Tensor scales_;        // (C,) float64: value of a field at weight one
  std::shared_ptr<const Solver> solver_;
};

}  // namespace freetalk::rig
