// The decoding of a clip from a few of its frames.
//
// What a decoder makes of a frame is a smooth function of its landmarks, and a clip's landmarks
// keep to a few modes: a few frames are decoded, the others interpolated between them in the space
// of landmark motion (geometry/greedy_interpolation.h), and made to follow their own landmarks as
// the decoder's frames are. Frames are decoded where the interpolation is most doubtful. Each is
// interpolated first, and the error found, in proportion to the doubt, tells how large it will be
// at the frames that are left.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <functional>

#include "freetalk/stm/landmark_decoder.h"

namespace freetalk::stm {

struct AdaptiveOptions {
  double tolerance_mm = 0.2;      // largest error of a vertex, mm; 0: every frame is decoded
  double tolerance_mean = 0.005;  // mean error, share of the mean motion, > 0
  template <class V>
  void fields(V& v) {
    v("tolerance_mm", tolerance_mm);
    v("tolerance_mean", tolerance_mean);
  }
  /// @throws std::invalid_argument naming the tolerance at fault.
  void check() const;
};

/// What was decoded, and the error that is expected of the frames in between.
struct AdaptiveReport {
  int64_t frames = 0, decoded = 0;
  double mean_error = 0.0;    // over all frames, share of their mean motion
  double max_error_mm = 0.0;  // largest of a vertex
};

/// The frames' displacements, within the tolerances of what decoder.decode() gives. Frames are
/// decoded by decoder.fastest() where its rounding, measured on two of them, leaves room for the
/// interpolation. No bit depends on the number of threads or the memory. Memory: the
/// decoded frames beside the decoder's own; their number stops growing with the clip.
/// @param landmarks (T, 68, 3) displacements, metres.
/// @param sink called with (first frame, (t, V, 3) float32 displacements in metres) in order.
/// @param report filled if given.
/// @param progress called with the finished share in [0, 1]; may throw to stop.
/// @throws std::invalid_argument for another shape or a tolerance out of range.
void decode_adaptively(const LandmarkDecoder& decoder, const at::Tensor& landmarks,
                       const std::function<void(int64_t, const at::Tensor&)>& sink,
                       const AdaptiveOptions& options = {}, AdaptiveReport* report = nullptr,
                       const std::function<void(double)>& progress = {});

/// The same as one tensor, (T, V, 3).
at::Tensor decode_adaptively(const LandmarkDecoder& decoder, const at::Tensor& landmarks,
                             const AdaptiveOptions& options = {}, AdaptiveReport* report = nullptr);

}  // namespace freetalk::stm
