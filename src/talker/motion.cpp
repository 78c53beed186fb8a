#include "motion.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <utility>

#include "freetalk/animation/resample.h"
#include "freetalk/core/error.h"
#include "freetalk/core/random.h"
#include "freetalk/speech/features.h"
#include "freetalk/talker/blinks.h"
#include "rest.h"

namespace freetalk::talker {
namespace {

// Where a sampler other than the weights' own is asked for; DPM-Solver++'s are within 2 % of a
// hundred steps of DDIM.
constexpr int64_t kDpmSolverSteps = 20, kOtherSteps = 50;

/// Codes (K, T, Z), at its own rate, that FaceTalk gives to each seed.
at::Tensor spoken_codes(const TalkerModels& models, const at::Tensor& samples,
                        const std::vector<int64_t>& seeds, const AnimateOptions& options,
                        const std::string& precision, c10::Device device, Stages& stages) {
  speech::SpeechEncoder encoder = models.speech;
  facetalk::FaceTalk denoiser = models.facetalk;
  const auto& own = denoiser->options();
  speech::EncodeOptions encoding;
  encoding.resample = own.feature_resampling;
  const auto features = speech::encode_speech(encoder, samples, own.fps, encoding,
                                              [&](double share) { stages.at(share); });
  stages.begin("motion");
  return facetalk::generate(denoiser, features.to(device),
                            code_options(options, precision, models.code_motion),
                            {seeds.begin(), seeds.end()}, [&](int64_t done, int64_t total) {
                              stages.at(static_cast<double>(done) / static_cast<double>(total));
                            });
}

/// Motion that each seed gives to the speech.
std::vector<Motion> spoken_motion(const TalkerModels& models, const audio::Audio& audio,
                                  int64_t num_frames, const std::vector<int64_t>& seeds,
                                  const AnimateOptions& options, const std::string& precision,
                                  c10::Device device, Stages& stages) {
  speech::SpeechEncoder encoder = models.speech;
  ats::Ats denoiser = models.ats;
  const auto& own = denoiser->options();
  stages.begin("speech");
  const auto heard = audio.sample_rate_hz == speech::kSampleRateHz
                         ? audio
                         : audio::resample(audio, speech::kSampleRateHz);
  const auto samples = at::tensor(heard.samples);
  const auto at_rate = [&](const at::Tensor& motion, double fps, const at::Tensor& landmarks) {
    return animation::resample_motion(motion.to(at::kCPU), fps, options.fps, num_frames, landmarks)
        .contiguous();
  };
  std::vector<Motion> result;
  if (options.motion == "facetalk") {
    const auto& speaker = models.facetalk;
    const double fps = speaker->options().fps;
    const auto codes = spoken_codes(models, samples, seeds, options, precision, device, stages);
    const double gain = models.code_motion.articulation * options.articulation;
    for (const auto& one : codes.unbind()) {
      const auto spoken = speaker->landmarks(one);
      const auto articulated = ats::articulate(spoken, gain);
      result.push_back({at_rate(articulated, fps, articulated), at_rate(one, fps, articulated),
                        at_rate(spoken, fps, articulated)});
    }
    return result;
  }
  const auto features =
      speech::encode_speech(encoder, samples, own.fps, {}, [&](double share) { stages.at(share); });
  stages.begin("motion");
  const auto keys = emotion_keys(options.emotion, options.intensity, own);
  const auto felt = keys.size() == 1
                        ? ats::constant_affect(keys[0].emotion.to(device), keys[0].intensity)
                        : ats::interpolate(keys, features.size(0), own.fps);
  std::vector<at::Generator> generators;
  for (const int64_t seed : seeds) {
    generators.push_back(core::make_generator(static_cast<uint64_t>(seed), device));
  }
  const auto motion = ats::generate(
      denoiser, features.to(device), felt, sampling_options(options, precision, models.generate),
      generators, [&](int64_t done, int64_t total) {
        stages.at(static_cast<double>(done) / static_cast<double>(total));
      });
  for (const auto& one : motion.unbind()) result.push_back({at_rate(one, own.fps, one), {}, {}});
  return result;
}

/// `own` with the sampler, its steps and its guidance that were chosen, for either motion.
template <class Sampling>
Sampling chosen_sampling(const AnimateOptions& options, const std::string& precision,
                         Sampling own) {
  if (options.sampler && *options.sampler != own.sampler) {
    own.sampler = *options.sampler;
    own.spacing = "auto";
    own.eta = 0;
    own.num_steps = own.sampler == "dpmpp" ? kDpmSolverSteps : kOtherSteps;
  }
  own.num_steps = options.num_steps.value_or(own.num_steps);
  own.eta = options.eta.value_or(own.eta);
  own.audio_guidance = options.audio_guidance.value_or(own.audio_guidance);
  own.precision = precision;
  return own;
}

}  // namespace

facetalk::GenerateOptions code_options(const AnimateOptions& options, const std::string& precision,
                                       facetalk::GenerateOptions own) {
  own = chosen_sampling(options, precision, std::move(own));
  own.temperature = options.mouth_temperature.value_or(own.temperature);
  return own;
}

ats::GenerateOptions sampling_options(const AnimateOptions& options, const std::string& precision,
                                      ats::GenerateOptions own) {
  own = chosen_sampling(options, precision, std::move(own));
  own.affect_guidance = options.affect_guidance.value_or(own.affect_guidance);
  own.mouth_temperature = options.mouth_temperature.value_or(own.mouth_temperature);
  own.articulation *= options.articulation;
  return own;
}

std::vector<ats::EmotionKey> emotion_keys(const std::string& emotion,
                                          std::optional<double> intensity,
                                          const ats::AtsOptions& own) {
  const auto strongest = static_cast<double>(own.num_intensities);
  auto keys =
      ats::parse_emotion_keys(emotion, own.emotions, intensity.value_or((1 + strongest) / 2));
  for (ats::EmotionKey& key : keys) {
    FREETALK_CHECK(key.intensity >= 1 && key.intensity <= strongest, "emotion '", emotion,
                   "': intensity must be between 1 and ", strongest, ", found ", key.intensity);
    // Neutral has one intensity.
    if (own.emotions.front() == "neutral" && key.emotion[0].item<float>() == 1.0f)
      key.intensity = 1;
  }
  return keys;
}

void check_performance(const audio::Audio& audio, const std::vector<int64_t>& seeds,
                       const AnimateOptions& options, const std::string& precision,
                       const TalkerModels& models) {
  options.check();
  FREETALK_CHECK(!seeds.empty(), "expected at least one seed");
  for (const int64_t seed : seeds) {
    FREETALK_CHECK(seed >= 0, "seed must not be negative, found ", seed);
  }
  emotion_keys(options.emotion, options.intensity, models.ats->options());
  if (options.motion == "facetalk") {
    FREETALK_CHECK(models.facetalk, "these weights hold no facetalk/: train one with `freetalk ",
                   "train facetalk` into their folder, or leave motion at ats");
    code_options(options, precision, models.code_motion).check();
  } else {
    sampling_options(options, precision, models.generate).check();
  }
  audio.check();
  FREETALK_CHECK(!audio.samples.empty(), "the audio has no samples");
}

std::vector<Motion> motion_of(const TalkerModels& models, const audio::Audio& audio,
                              int64_t num_frames, const std::vector<int64_t>& seeds,
                              const AnimateOptions& options, const std::string& precision,
                              c10::Device device, Stages& stages, Report& report) {
  const auto& landmarks = models.face.landmarks68;
  std::vector<Motion> motions;
  if (is_silent(audio)) {
    report.notices.push_back(options.blinks
                                 ? "the audio is silent: the face rests, breathes and blinks"
                                 : "the audio is silent: the face rests and breathes");
    for (size_t k = 0; k < seeds.size(); ++k) {
      motions.push_back({rest_motion(landmarks, num_frames, options.fps), {}, {}});
    }
  } else {
    if (options.motion == "facetalk" && options.emotion != "neutral") {
      report.notices.push_back("FaceTalk's motion knows no emotions: '" + options.emotion +
                               "' is not shown");
    }
    motions = spoken_motion(models, audio, num_frames, seeds, options, precision, device, stages);
    const auto keys = emotion_keys(options.emotion, options.intensity, models.ats->options());
    if (keys.size() > 1 && keys.back().time_s > audio.duration_s()) {
      report.notices.push_back(core::join("the emotion at ", keys.back().time_s,
                                          " s lies beyond the end of the speech at ",
                                          audio.duration_s(), " s and is not reached"));
    }
  }
  if (options.blinks) {
    for (size_t k = 0; k < seeds.size(); ++k) {
      add_blinks(motions[k].landmarks, landmarks, options.fps, static_cast<uint64_t>(seeds[k]));
    }
  }
  return motions;
}

}  // namespace freetalk::talker
