// What the glTF of a mesh from memory and that of a mesh's own file have in common.
#pragma once

#include <filesystem>

#include "freetalk/animation/animation.h"
#include "gltf_file.h"

namespace freetalk::animation {

/// Puts the speech into the file as KHR_audio_emitter describes it, for those that read that;
/// a .gltf names the file beside it.
void add_sound(Json& root, GltfBuffer& buffer, const Animation& animation,
               const std::filesystem::path& path);

/// Frame rate and metadata, in asset.extras.
void add_facts(Json& root, const Animation& animation, Json metadata);

/// Adds a name to a list of extensions unless it is there.
void use_extension(Json& root, const char* list, const char* name);

/// The file that the mesh was read from with the motion added; nodes, skins, materials, textures
/// and other animations stay; where the head moves, a node "head" carries what was in the scene but
/// lamps and cameras. @return false, having written nothing, where that file is no glTF with a
/// scene or no longer what the mesh was read from.
bool save_into_source(const std::filesystem::path& path, const Animation& animation,
                      const BlendShapes& shapes, const SaveOptions& options, SaveReport& report);

}  // namespace freetalk::animation
