// An animation as one mesh file per frame.
#pragma once

#include <filesystem>
#include <string>

#include "freetalk/animation/animation.h"

namespace freetalk::animation {

/// Writes frame_00000.<extension> ... into `folder`: all of them into a temporary neighbour first,
/// then each is renamed into place, and frames of an earlier, longer sequence are removed.
SaveReport save_sequence(const std::filesystem::path& folder, const std::string& extension,
                         const Animation& animation);

}  // namespace freetalk::animation
