// What an earlier save into the same glTF left there is taken out, so that a second one replaces
// it.
#include <algorithm>
#include <set>

#include "gltf_parts.h"

namespace freetalk::animation {
namespace {

/// Whether we wrote a part of the file. @param named a part of a file that is all ours counts by
/// its name.
bool is_ours(const Json& part, bool named) {
  if (named) return true;
  const auto extras = part.find("extras");
  return extras != part.end() && extras->is_object() && extras->contains("generator") &&
         (*extras)["generator"] == kGenerator;
}

bool has_name(const Json& part, const char* name) {
  return part.contains("name") && part["name"] == name;
}

/// Takes out of the list `parent[key]` what is gone, and the list where nothing is left.
void filter(Json& parent, const char* key, const std::vector<bool>& gone) {
  if (!parent.contains(key)) return;
  Json left = Json::array();
  const Json& list = parent[key];
  for (size_t i = 0; i < list.size(); ++i) {
    if (i >= gone.size() || !gone[i]) left.push_back(list[i]);
  }
  if (left.empty()) {
    parent.erase(key);
  } else {
    parent[key] = std::move(left);
  }
}

/// Which targets of a mesh are ours.
std::vector<bool> our_targets(const Json& mesh, bool all_ours) {
  size_t count = 0;
  for (const Json& primitive : mesh.at("primitives")) {
    if (primitive.contains("targets")) count = std::max(count, primitive["targets"].size());
  }
  std::vector<bool> ours(count, all_ours);
  const Json extras = mesh.value("extras", Json::object());
  if (all_ours || !extras.is_object() || !extras.contains(kOurTargets)) return ours;
  const Json names = extras.value("targetNames", Json::array());
  const Json& mine = extras[kOurTargets];
  for (size_t k = 0; k < std::min(count, names.size()); ++k) {
    ours[k] = std::find(mine.begin(), mine.end(), names[k]) != mine.end();
  }
  return ours;
}

void remove_targets(Json& mesh, const std::vector<bool>& gone) {
  for (Json& primitive : mesh["primitives"]) filter(primitive, "targets", gone);
  filter(mesh, "weights", gone);
  if (!mesh.contains("extras") || !mesh["extras"].is_object()) return;
  Json& extras = mesh["extras"];
  filter(extras, "targetNames", gone);
  extras.erase(kOurTargets);
  if (extras.empty()) mesh.erase("extras");
}

/// What the head carried is in the scene again; the node itself goes where it is the last.
void remove_head(Json& root, size_t head) {
  const Json carried = root["nodes"][head].value("children", Json::array());
  for (Json& scene : root["scenes"]) {
    Json roots = Json::array();
    for (const Json& top : scene.value("nodes", Json::array())) {
      if (top.get<size_t>() == head) {
        roots.insert(roots.end(), carried.begin(), carried.end());
      } else {
        roots.push_back(top);
      }
    }
    if (!roots.empty()) scene["nodes"] = std::move(roots);
  }
  root["nodes"][head].erase("children");
  if (head + 1 == root["nodes"].size()) root["nodes"].erase(head);
}

/// The speech, which is the last of what is heard.
bool remove_sound(Json& root, bool all_ours) {
  if (!root.contains("extensions") || !root["extensions"].contains(kAudioExtension)) return false;
  Json& all = root["extensions"][kAudioExtension];
  for (const char* list : {"audio", "sources", "emitters"}) {
    if (!all.contains(list) || all[list].empty()) return false;
  }
  Json &audio = all["audio"], &sources = all["sources"], &emitters = all["emitters"];
  const size_t emitter = emitters.size() - 1, source = sources.size() - 1;
  const bool ours = is_ours(emitters.back(), all_ours && has_name(emitters.back(), "speech")) &&
                    emitters.back().value("sources", Json()) == Json::array({source}) &&
                    sources.back().value("audio", Json()) == audio.size() - 1;
  if (!ours) return false;
  for (Json* list : {&audio, &sources, &emitters}) list->erase(list->size() - 1);
  for (Json& scene : root["scenes"]) {
    if (!scene.contains("extensions") || !scene["extensions"].contains(kAudioExtension)) continue;
    Json& heard = scene["extensions"][kAudioExtension]["emitters"];
    heard.erase(std::remove(heard.begin(), heard.end(), Json(emitter)), heard.end());
    if (heard.empty()) scene["extensions"].erase(kAudioExtension);
    if (scene["extensions"].empty()) scene.erase("extensions");
  }
  if (!emitters.empty()) return true;
  root["extensions"].erase(kAudioExtension);
  if (root["extensions"].empty()) root.erase("extensions");
  Json& used = root["extensionsUsed"];
  used.erase(std::remove(used.begin(), used.end(), Json(kAudioExtension)), used.end());
  if (used.empty()) root.erase("extensionsUsed");
  return true;
}

/// All whole numbers below a part of the file, or those called `key`.
void collect(const Json& part, const char* key, std::set<int64_t>& found) {
  for (const auto& [name, value] : part.items()) {
    if (value.is_structured()) {
      collect(value, key, found);
    } else if (value.is_number_integer() && (key == nullptr || name == key)) {
      found.insert(value.get<int64_t>());
    }
  }
}

void drop_unused_end(Json& root, const char* key, const std::set<int64_t>& used) {
  if (!root.contains(key)) return;
  Json& list = root[key];
  while (!list.empty() && used.count(static_cast<int64_t>(list.size()) - 1) == 0) {
    list.erase(list.size() - 1);
  }
}

/// Accessors and views that nothing refers to, as far as they are the last: no number changes.
void drop_unused(Json& root) {
  std::set<int64_t> accessors, views;
  const auto collect_from = [&](const char* list, const char* part) {
    if (!root.contains(list)) return;
    for (const Json& entry : root[list]) {
      if (entry.contains(part)) collect({{part, entry[part]}}, nullptr, accessors);
    }
  };
  collect_from("meshes", "primitives");
  collect_from("animations", "samplers");
  collect_from("skins", "inverseBindMatrices");
  collect_from("nodes", "extensions");
  drop_unused_end(root, "accessors", accessors);
  collect(root, "bufferView", views);
  drop_unused_end(root, "bufferViews", views);
}

}  // namespace

FormerMotion remove_former_motion(Json& root) {
  const Json asset = root.value("asset", Json::object());
  const bool all_ours = asset.contains("generator") && asset["generator"] == kGenerator;
  FormerMotion former;
  for (size_t m = 0; root.contains("meshes") && m < root["meshes"].size(); ++m) {
    const std::vector<bool> gone = our_targets(root["meshes"][m], all_ours);
    if (std::find(gone.begin(), gone.end(), true) == gone.end()) continue;
    remove_targets(root["meshes"][m], gone);
    former.targets[static_cast<int64_t>(m)] = gone;
  }
  for (Json& node : root["nodes"]) {
    const auto gone = former.targets.find(node.value("mesh", int64_t{-1}));
    if (gone != former.targets.end()) filter(node, "weights", gone->second);
  }
  former.found = !former.targets.empty();
  std::vector<bool> played;
  for (const Json& animation : root.value("animations", Json::array())) {
    played.push_back(is_ours(animation, all_ours && has_name(animation, "talk")));
    former.found |= played.back();
  }
  filter(root, "animations", played);
  for (size_t n = root["nodes"].size(); n-- > 0;) {
    const Json& node = root["nodes"][n];
    if (!has_name(node, "head") || node.contains("mesh") || !is_ours(node, all_ours)) continue;
    remove_head(root, n);
    former.found = true;
  }
  former.found |= remove_sound(root, all_ours);
  if (former.found) drop_unused(root);
  return former;
}

}  // namespace freetalk::animation
