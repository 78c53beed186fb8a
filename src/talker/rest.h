// What a face does while nothing is said.
#pragma once

#include <ATen/core/Tensor.h>
#include <Eigen/Core>

#include <cstdint>

#include "freetalk/audio/audio.h"

namespace freetalk::talker {

/// Whether no 100 ms of the clip are louder than -70 dB of full scale.
bool is_silent(const audio::Audio& audio);

/// (T, 68, 3) float32 m: breathing (4 s, nostrils and a trace of the chin).
/// @param landmarks (68, 3) m, the template's
at::Tensor rest_motion(const Eigen::MatrixXd& landmarks, int64_t num_frames, double fps);

}  // namespace freetalk::talker
