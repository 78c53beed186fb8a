#include "freetalk/talker/live.h"

#include <ATen/ATen.h>
#include <torch/torch.h>

#include <algorithm>
#include <cmath>

#include "face_state.h"
#include "freetalk/ats/motion_stream.h"
#include "freetalk/core/error.h"
#include "freetalk/core/torch_error.h"
#include "freetalk/speech/stream.h"
#include "freetalk/talker/blinks.h"
#include "freetalk/talker/head_motion.h"
#include "freetalk/talker/talker.h"
#include "motion.h"

namespace freetalk::talker {
namespace {

constexpr auto kRate = static_cast<double>(speech::kSampleRateHz);

speech::EncodeOptions hearing(const LiveOptions& options) {
  speech::EncodeOptions result;
  result.streamable = true;
  result.context_s = options.context_s;
  result.lookahead_s = options.lookahead_s;
  result.fade_s = options.fade_s;
  result.window_s = options.context_s + options.lookahead_s + options.hop_s;
  return result;
}

/// What a stream has in common with a clip.
AnimateOptions performance(const LiveOptions& options) {
  AnimateOptions result;
  result.emotion = options.emotion;
  result.intensity = options.intensity;
  result.seed = options.seed;
  result.audio_guidance = options.audio_guidance;
  result.affect_guidance = options.affect_guidance;
  result.mouth_temperature = options.mouth_temperature;
  result.articulation = options.articulation;
  return result;
}

ats::MotionStreamOptions moving(const LiveOptions& options, const Face::State& face) {
  ats::MotionStreamOptions result;
  result.generate =
      sampling_options(performance(options), face.options.precision, face.models->generate);
  result.generate.sampler = options.sampler;
  result.generate.num_steps = options.num_steps;
  result.generate.spacing = "auto";
  result.generate.eta = 0;
  result.window_frames = options.window_frames;
  result.redo_frames = options.redo_frames;
  result.emotion_ramp_s = options.emotion_ramp_s;
  return result;
}

}  // namespace

void LiveOptions::check() const {
  performance(*this).check();
  FREETALK_CHECK(std::isfinite(hop_s) && hop_s > 0, "hop_s must be positive, found ", hop_s);
  FREETALK_CHECK(std::isfinite(lookahead_s) && lookahead_s > 0,
                 "lookahead_s must be positive, found ", lookahead_s);
  FREETALK_CHECK(std::isfinite(fade_s) && fade_s > 0, "fade_s must be positive, found ", fade_s);
}

struct Live::State {
  Face face;
  LiveOptions options;
  speech::SpeechStream hearing;
  ats::MotionStream motion;
  BlinkStream blinks;
  std::optional<HeadMotionStream> head;
  const rig::FaceRig* rig;  // of the face; null: STM decodes
  rig::SolveState solved;
  int64_t num_samples = 0, num_frames = 0;

  const ats::AtsOptions& own() const { return face.state().models->ats->options(); }

  State(Face on, const LiveOptions& chosen)
      : face(std::move(on)),
        options(chosen),
        hearing(face.state().models->speech, own().fps, talker::hearing(chosen)),
        motion(face.state().models->ats, emotion_keys(chosen.emotion, chosen.intensity, own()),
               static_cast<uint64_t>(chosen.seed), moving(chosen, face.state())),
        blinks(make_blinks()),
        head(make_head()),
        rig(chosen.rig && !face.state().models->rig.names.empty() ? &face.rig() : nullptr) {}

  BlinkStream make_blinks() const {
    return {face.state().models->face.landmarks68, own().fps, static_cast<uint64_t>(options.seed)};
  }

  std::optional<HeadMotionStream> make_head() const {
    if (!options.head_motion) return {};
    return HeadMotionStream(speech::kSampleRateHz, own().fps, static_cast<uint64_t>(options.seed));
  }

  /// Samples that cannot complete two pieces of speech: a window is always one piece.
  int64_t most() const {
    return std::max<int64_t>(1, static_cast<int64_t>(std::floor(options.hop_s * kRate)));
  }

  void add(at::Tensor made, std::vector<LiveFrame>& frames) {
    if (options.blinks) blinks.add(made);
    const at::Tensor weights =
        rig != nullptr ? rig->solve(face.state().carried(made), &solved) : at::Tensor();
    const at::Tensor poses = head ? head->next(made.size(0)) : at::Tensor();
    const auto of_frame = [](const at::Tensor& all, int64_t t) {
      return all.defined() ? all[t] : all;
    };
    for (int64_t t = 0; t < made.size(0); ++t) {
      frames.push_back({num_frames, static_cast<double>(num_frames) / own().fps, made[t],
                        of_frame(weights, t), of_frame(poses, t)});
      ++num_frames;
    }
  }

  void restart() {
    blinks = make_blinks();
    head = make_head();
    solved = {};
    num_samples = num_frames = 0;
  }
};

Live::Live(Face face, const LiveOptions& options) {
  core::with_plain_errors("live", [&] {
    options.check();
    FREETALK_CHECK(options.redo_frames >= 0 && options.context_s >= 0.1,
                   "redo_frames must not be negative, and context_s be at least 0.1");
    state_ = std::make_unique<State>(std::move(face), options);
  });
}

Live::~Live() = default;
Live::Live(Live&&) noexcept = default;

std::vector<LiveFrame> Live::push(const std::vector<float>& samples) {
  return core::with_plain_errors("live", [&] {
    const torch::NoGradGuard no_grad;
    State& s = *state_;
    std::vector<LiveFrame> frames;
    const auto count = static_cast<int64_t>(samples.size());
    for (int64_t first = 0; first < count; first += s.most()) {
      const int64_t some = std::min(s.most(), count - first);
      const auto heard =
          at::from_blob(const_cast<float*>(samples.data() + first), {some}, at::kFloat);
      if (s.head) s.head->hear(samples.data() + first, some);
      const auto features = s.hearing.push(heard);
      s.num_samples += some;
      if (features.size(0) > 0) s.add(s.motion.push(features), frames);
    }
    return frames;
  });
}

std::vector<LiveFrame> Live::finish() {
  return core::with_plain_errors("live", [&] {
    const torch::NoGradGuard no_grad;
    State& s = *state_;
    std::vector<LiveFrame> frames;
    if (s.num_samples == 0) return frames;
    s.add(s.motion.finish(s.hearing.finish()), frames);
    s.restart();
    return frames;
  });
}

void Live::reset() { state_ = std::make_unique<State>(state_->face, state_->options); }

void Live::set_emotion(const std::string& emotion, std::optional<double> intensity) {
  State& s = *state_;
  s.motion.set_emotion(emotion_keys(emotion, intensity, s.own()),
                       static_cast<double>(s.num_samples) / kRate);
}

at::Tensor Live::decode(const LiveFrame& frame) const {
  return core::with_plain_errors("live", [&] {
    const torch::NoGradGuard no_grad;
    const Face::State& face = state_->face.state();
    const auto landmarks = face.carried(frame.landmarks.unsqueeze(0));
    const auto skin = frame.weights.defined() ? face.rig({}).vertices(frame.weights.unsqueeze(0))
                                              : face.decoder->decode(landmarks.to(face.device));
    return face.rest + face.in_mesh(skin, landmarks).squeeze(0);
  });
}

at::Tensor Live::head(const LiveFrame& frame) const {
  return core::with_plain_errors("live", [&] {
    if (!frame.head.defined()) return frame.head;
    return state_->face.state().in_mesh(frame.head.unsqueeze(0)).squeeze(0);
  });
}

double Live::latency_s() const {
  return state_->hearing.latency_s() + static_cast<double>(state_->options.redo_frames) / fps();
}

double Live::fps() const { return state_->own().fps; }
const LiveOptions& Live::options() const { return state_->options; }
const Face& Live::face() const { return state_->face; }
int64_t Live::num_held() const {
  const State& s = *state_;
  return s.hearing.num_held() + s.motion.num_held() + (s.head ? s.head->num_held() : 0);
}

Live Face::live(const LiveOptions& options) const { return Live(*this, options); }

Live Talker::live(const Face& face, const LiveOptions& options) const {
  FREETALK_CHECK(face.state().models == models_,
                 "the face was prepared by a talker of other weights");
  return face.live(options);
}

}  // namespace freetalk::talker
