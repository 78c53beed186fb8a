// A mesh made ready to speak, once; then any number of clips, seeds and live streams.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "freetalk/animation/animation.h"
#include "freetalk/audio/audio.h"
#include "freetalk/geometry/alignment.h"
#include "freetalk/mesh/mesh.h"
#include "freetalk/talker/options.h"

namespace freetalk::rig {
class FaceRig;
}

namespace freetalk::talker {

class Live;
struct LiveOptions;

struct StageTime {
  std::string stage;  // "align", "parts", "operators", "features"; "speech", "motion", "surface"
  double seconds = 0.0;
};

/// What was found, guessed and measured on the way.
struct Report {
  geometry::Alignment alignment;
  std::string parts;                 // "9409 skin, 2204 with the jaw (vertices)"
  std::vector<std::string> notices;  // sentences that a user should read
  std::vector<StageTime> timings;
  int64_t num_frames = 0;        // of all performances
  int64_t decoded_frames = 0;    // those that STM decoded; the others are interpolated
  double decode_error = 0.0;     // of interpolated frames, checked: share of the mean motion
  double decode_error_mm = 0.0;  // the same, largest of any vertex
};

/// Called with the stage and its finished share in [0, 1], on the caller's thread. Whatever it
/// throws ends the work and reaches the caller: so a user's cancelling is done.
using Progress = std::function<void(const std::string& stage, double fraction)>;

/// Alignment, parts, surface operators, STM's features of the surface and its packed decoder.
/// Immutable: a copy is cheap and shares everything, and all of it may be used from many threads at
/// once. Made by Talker::prepare; lives on without the talker.
class Face {
 public:
  struct State;
  explicit Face(std::shared_ptr<const State> state);

  /// T = max(1, round(duration * fps)) frames. The same options, inputs and machine give the same
  /// bits on the CPU, on a GPU the same motion up to rounding. Memory beside the (T, V, 3) result
  /// doesn't grow with T. Silence gives a resting face and a notice.
  /// @param report filled if given.
  /// @param out (T, V, 3) contiguous float32 on the CPU, to be filled and to be the animation's
  /// displacements; undefined: a new one. See num_frames().
  /// @throws std::invalid_argument for options out of range, an unknown emotion, no samples, `out`
  /// of another form; whatever `progress` throws.
  animation::Animation animate(const audio::Audio& audio, const AnimateOptions& options = {},
                               const Progress& progress = {}, Report* report = nullptr,
                               const at::Tensor& out = {}) const;

  /// Several performances of one speech: the motion of all seeds is sampled together.
  /// @param seeds take the place of options.seed.
  /// @param out (seeds, T, V, 3) as above, or undefined.
  /// @returns one animation a seed: the motion is that of animate() up to rounding, and every frame
  /// within options.tolerance_mm of decoding it.
  std::vector<animation::Animation> animate_many(const audio::Audio& audio,
                                                 const std::vector<int64_t>& seeds,
                                                 const AnimateOptions& options = {},
                                                 const Progress& progress = {},
                                                 Report* report = nullptr,
                                                 const at::Tensor& out = {}) const;

  /// The skin as named blend shapes, canonical frame; include rig/face_rig.h. Made when it is first
  /// asked for (STM decodes up to 150 poses), then shared; kept in the folder of the operators.
  /// @throws std::runtime_error where the weights hold no poses to make it of; whatever `progress`
  /// throws.
  const rig::FaceRig& rig(const Progress& progress = {}) const;

  /// An animation of this face as ARKit's 51 shapes, for Animation::save: targets in the mesh's own
  /// unit and axes, weights of the landmarks that it was made of.
  /// @throws std::invalid_argument for an animation without landmarks; as rig().
  animation::BlendShapes blend_shapes(const animation::Animation& animation,
                                      const Progress& progress = {}) const;

  /// A stream on this face; include talker/live.h. @throws as Live.
  Live live(const LiveOptions& options) const;

  /// T of an animation of this sound.
  static int64_t num_frames(const audio::Audio& audio, double fps);

  const mesh::Mesh& mesh() const;
  const FaceOptions& options() const;
  const geometry::Alignment& alignment() const;
  /// How the preparation went: alignment, parts, notices and timings.
  const Report& report() const;
  const State& state() const { return *state_; }

 private:
  std::shared_ptr<const State> state_;
};

}  // namespace freetalk::talker
