// What the glTF of a mesh from memory and that of a mesh's own file have in common.
#pragma once

#include <filesystem>
#include <map>
#include <vector>

#include "freetalk/animation/animation.h"
#include "gltf_file.h"

namespace freetalk::animation {

/// The file's generator where all of it is ours; what we add to another's says so in its extras.
inline constexpr const char* kGenerator = "freetalk";
/// In the extras of a mesh: names of the targets that are ours.
inline constexpr const char* kOurTargets = "talkTargets";
inline constexpr const char* kAudioExtension = "KHR_audio_emitter";

/// Puts the speech into the file as KHR_audio_emitter describes it, for those that read that;
/// a .gltf names the file beside it.
void add_sound(Json& root, GltfBuffer& buffer, const Animation& animation,
               const std::filesystem::path& path);

/// Frame rate and metadata, in asset.extras.
void add_facts(Json& root, const Animation& animation, Json metadata);

/// The node that moves the head. @param carried its children.
Json head_json(Json carried);

/// Adds a name to a list of extensions unless it is there.
void use_extension(Json& root, const char* list, const char* name);

/// What was taken out of a file.
struct FormerMotion {
  bool found = false;
  std::map<int64_t, std::vector<bool>> targets;  ///< by mesh: which of its targets are gone
};

/// Takes out what an earlier save into the same file added: targets, animation, the head's node,
/// speech, and the numbers at the end that nothing refers to any more. Indices of what stays do not
/// change. @param root with "nodes" and "scenes".
FormerMotion remove_former_motion(Json& root);

/// The file that the mesh was read from with the motion added, in the place of one that we added
/// before; nodes, skins, materials, textures
/// and other animations stay; where the head moves, a node "head" carries what was in the scene but
/// lamps and cameras. @return false, having written nothing, where that file is no glTF with a
/// scene or no longer what the mesh was read from.
bool save_into_source(const std::filesystem::path& path, const Animation& animation,
                      const BlendShapes& shapes, const SaveOptions& options, SaveReport& report);

}  // namespace freetalk::animation
