// Landmark motion of a clip.
#pragma once

#include <ATen/core/Tensor.h>
#include <c10/core/Device.h>

#include <cstdint>
#include <vector>

#include "freetalk/audio/audio.h"
#include "freetalk/talker/models.h"
#include "freetalk/talker/options.h"
#include "stages.h"

namespace freetalk::talker {

/// The weights' own sampling options with those that were chosen in their place.
ats::GenerateOptions sampling_options(const AnimateOptions& options, const std::string& precision,
                                      ats::GenerateOptions own);

/// The same for AnimateOptions::motion "facetalk", whose temperature is that of all motion.
facetalk::GenerateOptions code_options(const AnimateOptions& options, const std::string& precision,
                                       facetalk::GenerateOptions own);

/// The emotion over time. @throws std::invalid_argument for text that cannot be read, unknown
/// emotions, intensities that the weights do not have.
std::vector<ats::EmotionKey> emotion_keys(const std::string& emotion,
                                          std::optional<double> intensity,
                                          const ats::AtsOptions& own);

/// Everything about a performance that can be wrong before the work begins.
/// @throws std::invalid_argument as Face::animate_many.
void check_performance(const audio::Audio& audio, const std::vector<int64_t>& seeds,
                       const AnimateOptions& options, const std::string& precision,
                       const TalkerModels& models);

/// What a seed makes of the speech, at options.fps, on the CPU.
struct Motion {
  at::Tensor landmarks;  // (T, 68, 3) float32 m
  /// FaceTalk's codes, (T, Z) float32, and the landmarks as they have them, before articulation and
  /// blinks; undefined where landmarks were spoken.
  at::Tensor codes, spoken;
};

/// Motion of each seed.
std::vector<Motion> motion_of(const TalkerModels& models, const audio::Audio& audio,
                              int64_t num_frames, const std::vector<int64_t>& seeds,
                              const AnimateOptions& options, const std::string& precision,
                              c10::Device device, Stages& stages, Report& report);

}  // namespace freetalk::talker
