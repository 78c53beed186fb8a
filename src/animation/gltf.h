// glTF 2.0 [Khronos] with morph targets and an animation of their weights.
#pragma once

#include <filesystem>

#include "freetalk/animation/animation.h"

namespace freetalk::animation {

/// Writes `path` (.glb, or .gltf with a .bin beside it). The node turns and scales the mesh to
/// metres, +Y up. Vertices keep their order; where a vertex has several texture coordinates, copies
/// of it are appended after the last one.
SaveReport save_gltf(const std::filesystem::path& path, const Animation& animation,
                     const BlendShapes& shapes, const SaveOptions& options);

}  // namespace freetalk::animation
