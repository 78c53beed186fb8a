// Speech in as it is spoken, a talking face out half a second later.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "freetalk/talker/face.h"

namespace freetalk::talker {

/// Options without a value are as the weights say.
struct LiveOptions {
  std::string emotion = "neutral";  // see AnimateOptions; keys count from the stream's start
  std::optional<double> intensity;  // see AnimateOptions
  double emotion_ramp_s = 0.5;      // over which set_emotion() changes the face
  int64_t seed = 0;
  // The delay is the sum of these two, half of fade_s, and redo_frames of motion: 0.42 s.
  double hop_s = 0.12;        // speech between two windows, in steps of 0.02 s; each costs a window
  double lookahead_s = 0.18;  // speech heard beyond what is shown; less: follows it less well
  double fade_s = 0.04;       // between neighbouring pieces of speech
  double context_s = 4.0;     // speech heard before; bounds what a hop costs
  int64_t window_frames = 60;     // see ats::MotionStreamOptions
  int64_t redo_frames = 3;        // see ats::MotionStreamOptions
  std::string sampler = "dpmpp";  // "dpmpp" or "ddim"
  int64_t num_steps = 4;          // denoising steps of a window
  std::optional<double> audio_guidance;
  std::optional<double> affect_guidance;
  std::optional<double> mouth_temperature;
  double articulation = 1.0;  // see AnimateOptions
  bool blinks = true;         // also blink where the model leaves the eyes open for long
  bool head_motion = false;   // small motion of the head, as LiveFrame::head; see head_motion()
  // Frames carry weights of the face's rig, which the first stream makes, and are decoded with it:
  // fast enough for live speech. Without, and with weights that hold no poses, STM decodes them.
  bool rig = true;

  template <class V>
  void fields(V& v) {
    v("emotion", emotion);
    v("intensity", intensity);
    v("emotion_ramp_s", emotion_ramp_s);
    v("seed", seed);
    v("hop_s", hop_s);
    v("lookahead_s", lookahead_s);
    v("fade_s", fade_s);
    v("context_s", context_s);
    v("window_frames", window_frames);
    v("redo_frames", redo_frames);
    v("sampler", sampler);
    v("num_steps", num_steps);
    v("audio_guidance", audio_guidance);
    v("affect_guidance", affect_guidance);
    v("mouth_temperature", mouth_temperature);
    v("articulation", articulation);
    v("blinks", blinks);
    v("head_motion", head_motion);
    v("rig", rig);
  }
  /// @throws std::invalid_argument naming the option at fault.
  void check() const;
};

struct LiveFrame {
  int64_t index = 0;
  double time_s = 0.0;   // of the speech that it belongs to: index / fps()
  at::Tensor landmarks;  // (68, 3) float32 m, displacements in the canonical frame
  at::Tensor weights;    // (W,) float32 in [0, 1] of face().rig().names(); undefined without rig
  /// (4, 4) float64: a point x, m, canonical frame, goes to R x + t; undefined without head_motion.
  at::Tensor head;
};

/// One stream on one face. Not to be shared between threads; the face may be.
class Live {
 public:
  /// @throws std::invalid_argument for options out of range, an unknown emotion.
  explicit Live(Face face, const LiveOptions& options = {});
  ~Live();
  Live(Live&&) noexcept;

  /// Frames that are final with these further samples, in order: the same however the samples are
  /// divided over the calls, to the bit on the CPU, up to rounding on a GPU. Memory does not grow,
  /// and no call costs more than its samples.
  /// @param samples (n,) in [-1, 1], 16 kHz, mono; n may be 0.
  std::vector<LiveFrame> push(const std::vector<float>& samples);
  /// The rest, as if the speech ended here: max(1, round(duration * fps)) frames in all. The stream
  /// then starts afresh. Nothing where nothing was pushed.
  std::vector<LiveFrame> finish();
  /// Forgets everything, as if nothing had been pushed.
  void reset();

  /// From the last sample that was pushed on. @param emotion as LiveOptions::emotion, its keys'
  /// times from now. @throws std::invalid_argument as the constructor.
  void set_emotion(const std::string& emotion, std::optional<double> intensity = std::nullopt);

  /// (V, 3) float32 vertices of a frame, in the mesh's own unit and axes.
  at::Tensor decode(const LiveFrame& frame) const;
  /// (4, 4) float64 rigid motion of the head in a frame, in the mesh's own unit and axes: the
  /// vertices are without it. Undefined without head_motion.
  at::Tensor head(const LiveFrame& frame) const;

  /// The longest time from a frame's moment to the sample that makes it final.
  double latency_s() const;
  double fps() const;
  const LiveOptions& options() const;
  const Face& face() const;
  /// Numbers held between calls: they stop growing once the context is full.
  int64_t num_held() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace freetalk::talker

namespace freetalk {
using talker::Live;
using talker::LiveOptions;
}  // namespace freetalk
