// Motion while the speech is still being heard.
//
// Whenever features of further frames come, a window of the last frames is denoised as a whole. Its
// frames that were shown before are known: a model that was trained so (AtsOptions::known_prefix)
// sees them clean; to another they take the place of the estimate of x_0 at every reverse step [as
// in-painting, Lugmayr et al. 2022, without its repeats]. Each frame keeps its noise from window to
// window. The last few frames of a window, whose audio band is cut off, are not shown but made
// again with the next one.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <memory>
#include <vector>

#include "freetalk/ats/ats.h"
#include "freetalk/ats/emotion.h"
#include "freetalk/ats/generate.h"

namespace freetalk::ats {

struct MotionStreamOptions {
  GenerateOptions generate{.sampler = "dpmpp", .num_steps = 10};  // no noise after the first
  int64_t window_frames = 60;   // of a window, <= max_frames of the model
  int64_t redo_frames = 3;      // last frames of a window that are made again; the audio band
  double emotion_ramp_s = 0.5;  // over which set_emotion() changes the face
  void check() const;
};

/// Not to be shared between threads; the model may be.
class MotionStream {
 public:
  /// @param model in eval mode. @param emotions the first ones, times in the stream's seconds.
  /// @param seed of the noise: that of generate() with the same seed, but for the last frames.
  /// @throws std::invalid_argument for options out of range.
  MotionStream(Ats model, std::vector<EmotionKey> emotions, uint64_t seed,
               const MotionStreamOptions& options = {});
  ~MotionStream();
  MotionStream(MotionStream&&) noexcept;

  /// @param features (n, C) of the next frames; n may be 0. The result depends on how they are
  /// divided over the calls: every call is a window.
  /// @returns (m, 68, 3) float32 m, CPU: frames that are final now.
  at::Tensor push(const at::Tensor& features);
  /// The rest, as if the speech ended with these features; the stream then starts afresh.
  at::Tensor finish(const at::Tensor& features);
  void reset();

  /// From a moment on, over emotion_ramp_s: other emotions. @param keys times from that moment.
  void set_emotion(const std::vector<EmotionKey>& keys, double time_s);

  /// Numbers held between calls: they stop growing with the window.
  int64_t num_held() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace freetalk::ats
