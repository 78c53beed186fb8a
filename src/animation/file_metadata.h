// What a file in metres, +Y up, says of an animation.
#pragma once

#include <nlohmann/json.hpp>

#include "freetalk/animation/animation.h"

namespace freetalk::animation {

/// The animation's metadata; where the face lies ("alignment") is said of vertices in metres, +Y
/// up.
nlohmann::ordered_json metadata_in_metres(const Animation& animation);

}  // namespace freetalk::animation
