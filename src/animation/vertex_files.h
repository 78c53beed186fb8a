// Files that hold the vertices of every frame.
#pragma once

#include <filesystem>
#include <string>

#include "freetalk/animation/animation.h"

namespace freetalk::animation {

/// Writes frame_00000.EXTENSION ... into `folder`, which is made; frames of a longer sequence that
/// was there are removed.
SaveReport save_sequence(const std::filesystem::path& folder, const std::string& extension,
                         const Animation& animation, const SaveProgress& progress);

/// Writes a .pc2, the mesh's own unit and axes.
SaveReport save_pc2(const std::filesystem::path& path, const Animation& animation,
                    const SaveProgress& progress);

}  // namespace freetalk::animation
