// USD text with blend shapes, as Blender, Houdini, Maya and usdview read it.
#pragma once

#include <filesystem>

#include "freetalk/animation/animation.h"

namespace freetalk::animation {

/// Writes a .usda: a SkelRoot that places the mesh in metres, +Y up; the mesh with its polygons,
/// texture coordinates, colours and materials; its blend shapes; their weights, a time code a
/// frame; and the speech by the name of the file beside. Textures are written beside, into
/// "NAME.textures".
SaveReport save_usda(const std::filesystem::path& path, const Animation& animation,
                     const BlendShapes& shapes, const SaveOptions& options);

}  // namespace freetalk::animation
