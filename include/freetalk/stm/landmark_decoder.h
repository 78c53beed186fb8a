// What turns landmark motion into the motion of a surface, whatever the engine: STM on a mesh
// (stm/frame_decoder.h), a parametric head (talker's head engine).
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <functional>

namespace freetalk::stm {

class LandmarkFollower;

/// Immutable: decoding may run on several threads at a time. A frame's displacements depend on
/// nothing but its landmarks.
class LandmarkDecoder {
 public:
  virtual ~LandmarkDecoder() = default;

  /// Memory grows with a chunk of frames, not with T.
  /// @param landmarks (T, 68, 3) displacements, metres.
  /// @param sink called with (first frame, (t, V, 3) displacements in metres) in order, on the CPU.
  virtual void decode(const at::Tensor& landmarks,
                      const std::function<void(int64_t, const at::Tensor&)>& sink) const = 0;
  /// @returns (T, V, 3) displacements, metres, where the landmarks are.
  virtual at::Tensor decode(const at::Tensor& landmarks) const = 0;
  /// The same for a few frames now and then: slower, but keeps nothing in memory.
  virtual at::Tensor decode_once(const at::Tensor& landmarks) const { return decode(landmarks); }
  /// A faster decoder of the same surface with coarser numbers, or this one.
  virtual const LandmarkDecoder& fastest() const = 0;
  /// What makes the displacements follow the landmarks; null: nothing does.
  virtual const LandmarkFollower* follower() const = 0;
};

}  // namespace freetalk::stm
