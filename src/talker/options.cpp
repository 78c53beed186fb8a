#include <cmath>

#include "freetalk/core/error.h"
#include "freetalk/talker/talker.h"

namespace freetalk::talker {

void TalkerOptions::check() const {
  FREETALK_CHECK(!emotion.empty(), "emotion must not be empty");
  FREETALK_CHECK(intensity >= 1 && intensity <= 3, "intensity must be between 1 and 3, found ",
                 intensity);
  FREETALK_CHECK(std::isfinite(fps) && fps > 0 && fps <= 240,
                 "fps must be above 0 and at most 240, found ", fps);
  FREETALK_CHECK(seed >= 0, "seed must not be negative, found ", seed);
  FREETALK_CHECK(sampler.empty() || sampler == "ddim" || sampler == "ddpm" || sampler == "dpmpp",
                 "sampler must be ddim, ddpm or dpmpp, found '", sampler, "'");
  FREETALK_CHECK(precision == "float32" || precision == "bfloat16",
                 "precision must be float32 or bfloat16, found '", precision, "'");
  FREETALK_CHECK(num_steps >= 0, "num_steps must not be negative, found ", num_steps);
  FREETALK_CHECK(std::isfinite(eta) && eta <= 1, "eta must be at most 1, found ", eta);
  FREETALK_CHECK(std::isfinite(audio_guidance) && std::isfinite(affect_guidance),
                 "audio_guidance and affect_guidance must be finite");
  FREETALK_CHECK(std::isfinite(mouth_temperature) && mouth_temperature <= 1,
                 "mouth_temperature must be at most 1, found ", mouth_temperature);
  FREETALK_CHECK(memory_mb >= 1, "memory_mb must be at least 1, found ", memory_mb);
  geometry::AlignOptions{unit, up, forward}.check();
}

}  // namespace freetalk::talker
