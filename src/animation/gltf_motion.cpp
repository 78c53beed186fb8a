// The animation of a glTF file as motion of the mesh that load_mesh reads: its morph targets as
// displacements, a node that carries the whole mesh as the head's motion.
#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>

#include "core/file.h"
#include "core/scratch.h"
#include "freetalk/animation/animation.h"
#include "freetalk/core/error.h"
#include "gltf_parts.h"
#include "head_track.h"
#include "mesh/gltf_scene.h"
#include "sound.h"

namespace freetalk::animation {
namespace {

using mesh::GltfDocument;
using mesh::GltfPart;
using nlohmann::json;

constexpr double kMaxDurationS = audio::kMaxDurationS;

/// What moves in one node over time: weights, or its rotation or translation.
struct Track {
  std::vector<double> times;   // rising
  std::vector<double> values;  // (times, width)
  size_t width = 0;
  bool steps = false;

  /// Those of time `t`, held beyond the ends.
  std::vector<double> at(double t) const {
    const auto after = std::upper_bound(times.begin(), times.end(), t) - times.begin();
    const size_t high = std::min<size_t>(static_cast<size_t>(after), times.size() - 1);
    const size_t low = after == 0 ? 0 : static_cast<size_t>(after) - 1;
    const double gap = times[high] - times[low];
    const double share = gap > 0.0 && !steps ? std::clamp((t - times[low]) / gap, 0.0, 1.0) : 0.0;
    std::vector<double> result(width);
    for (size_t k = 0; k < width; ++k) {
      result[k] = (1 - share) * values[low * width + k] + share * values[high * width + k];
    }
    return result;
  }
};

/// @param components of the elements of the sampler's output.
Track read_track(const GltfDocument& document, const json& sampler, int64_t components) {
  Track track;
  track.times = document.accessor_numbers(document.whole(sampler, "input"), 1);
  track.values = document.accessor_numbers(document.whole(sampler, "output"), components);
  const std::string way = sampler.value("interpolation", std::string("LINEAR"));
  if (way != "LINEAR" && way != "STEP") {
    document.fail("has an animation of splines; sample it and export it again");
  }
  track.steps = way == "STEP";
  const bool fits = !track.times.empty() && track.values.size() % track.times.size() == 0 &&
                    std::is_sorted(track.times.begin(), track.times.end()) &&
                    track.times.front() >= 0.0 && track.times.back() <= kMaxDurationS;
  if (!fits) document.fail("has an animation that is damaged; export it again");
  track.width = track.values.size() / track.times.size();
  return track;
}

/// What one animation moves.
struct Tracks {
  std::map<int64_t, Track> weights;  // by node
  std::optional<Track> turn, shift;  // of the head

  bool empty() const { return weights.empty() && !turn && !shift; }

  double end() const {
    double last = 0.0;
    for (const auto& [node, track] : weights) last = std::max(last, track.times.back());
    if (turn) last = std::max(last, turn->times.back());
    if (shift) last = std::max(last, shift->times.back());
    return last;
  }

  at::Tensor pose_at(double t) const {
    const auto turned = turn ? turn->at(t) : std::vector<double>{0.0, 0.0, 0.0, 1.0};
    const auto shifted = shift ? shift->at(t) : std::vector<double>(3, 0.0);
    return head_pose(turned.data(), shifted.data());
  }
};

/// The node that carries all of the mesh and does nothing to it at rest: what it does over time is
/// the motion of the head. -1 without.
int64_t head_node(const GltfDocument& document, const std::vector<GltfPart>& parts) {
  const json& nodes = document.list("nodes");
  std::vector<int64_t> above(nodes.size(), -1);
  for (size_t n = 0; n < nodes.size(); ++n) {
    for (const int64_t child : document.indices(nodes[n], "children", nodes.size())) {
      above[static_cast<size_t>(child)] = static_cast<int64_t>(n);
    }
  }
  int64_t head = -1;
  for (const GltfPart& part : parts) {
    int64_t top = part.node;
    for (size_t steps = 0; top >= 0 && above[static_cast<size_t>(top)] >= 0; ++steps) {
      if (steps > nodes.size()) document.fail("has nodes in a circle; export it again");
      top = above[static_cast<size_t>(top)];
    }
    if (top < 0 || (head >= 0 && top != head)) return -1;
    head = top;
  }
  if (head < 0) return -1;
  for (const char* transform : {"matrix", "translation", "rotation", "scale"}) {
    if (nodes[static_cast<size_t>(head)].contains(transform)) return -1;
  }
  return head;
}

/// Of the first animation that moves weights or the head.
Tracks read_tracks(const GltfDocument& document, const std::vector<GltfPart>& parts) {
  const size_t nodes = document.list("nodes").size();
  const int64_t head = head_node(document, parts);
  for (const json& animation : document.list("animations")) {
    Tracks tracks;
    const json& samplers = document.list(animation, "samplers");
    for (const json& channel : document.list(animation, "channels")) {
      const json& target = channel.at("target");
      if (!target.contains("node")) continue;
      const int64_t node = document.index(target, "node", nodes);
      const auto path = target.value("path", std::string());
      const int64_t sampler = document.index(channel, "sampler", samplers.size());
      if (path == "weights") tracks.weights[node] = read_track(document, samplers[sampler], 1);
      if (node != head) continue;
      if (path == "rotation") tracks.turn = read_track(document, samplers[sampler], 4);
      if (path == "translation") tracks.shift = read_track(document, samplers[sampler], 3);
    }
    const bool fits =
        (!tracks.turn || tracks.turn->width == 4) && (!tracks.shift || tracks.shift->width == 3);
    if (!fits) document.fail("has an animation that is damaged; export it again");
    if (!tracks.empty()) return tracks;
  }
  document.fail("has no animation of morph targets or of the whole head");
}

/// Adds the motion of a primitive's vertices. @param weights (T, K).
void add_part(const GltfDocument& document, const GltfPart& part, const at::Tensor& weights,
              const at::Tensor& displacements) {
  const json& primitive = document.list("meshes")[part.mesh]["primitives"][part.primitive];
  const json& targets = document.list(primitive, "targets");
  const int64_t count = document.accessor_count(part.positions);
  const auto linear = at::empty({3, 3}, at::kDouble);
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) linear[c][r] = part.linear(r, c);
  }
  const auto place = displacements.narrow(1, part.first_vertex, count);
  const int64_t used = std::min<int64_t>(static_cast<int64_t>(targets.size()), weights.size(1));
  for (int64_t k = 0; k < used; ++k) {
    if (!targets[k].contains("POSITION")) continue;
    const int64_t accessor = document.whole(targets[k], "POSITION");
    std::vector<double> values = document.accessor_numbers(accessor, 3);
    if (static_cast<int64_t>(values.size()) != 3 * count) {
      document.fail("has morph targets of another size than its mesh; export it again");
    }
    const auto moved = at::from_blob(values.data(), {count, 3}, at::kDouble).matmul(linear);
    const auto moved32 = moved.to(at::kFloat);
    for (int64_t t = 0; t < weights.size(0); ++t) {
      const auto weight = weights[t][k].item<float>();
      if (weight != 0.0f) place[t].add_(moved32, weight);
    }
  }
}

audio::Audio read_sound(const GltfDocument& document) {
  const json extensions = document.root().value("extensions", json::object());
  const auto found = extensions.find(kAudioExtension);
  if (found == extensions.end()) return {};
  const json& sounds = document.list(*found, "audio");
  if (sounds.empty()) return {};
  const json& sound = sounds.back();
  if (sound.contains("uri")) return parse_wav(document.content_of(sound["uri"].get<std::string>()));
  return parse_wav(document.view_bytes(document.whole(sound, "bufferView")));
}

double rate_of(const GltfDocument& document, double wanted) {
  if (wanted > 0.0) return wanted;
  const json asset = document.root().value("asset", json::object());
  const json extras = asset.value("extras", json::object());
  const double fps = extras.is_object() ? extras.value("fps", 30.0) : 30.0;
  return std::isfinite(fps) && fps > 0.0 && fps <= 1000.0 ? fps : 30.0;
}

Animation read_motion(const std::filesystem::path& path, double wanted) {
  const GltfDocument document(path, core::read_text(path));
  std::vector<GltfPart> parts;
  Animation animation;
  animation.mesh = mesh::load_mesh(path);
  mesh::read_gltf_scene(document, &parts);
  const Tracks tracks = read_tracks(document, parts);
  animation.fps = rate_of(document, wanted);
  const int64_t frames = 1 + std::llround(tracks.end() * animation.fps);
  animation.displacements = core::scratch_tensor({frames, animation.mesh.num_vertices(), 3});
  animation.displacements.zero_();
  std::map<int64_t, std::set<int>> done;  // first vertices by node: primitives may share them
  for (const GltfPart& part : parts) {
    const auto track = tracks.weights.find(part.node);
    if (track == tracks.weights.end() || !done[part.node].insert(part.first_vertex).second)
      continue;
    const auto weights = at::empty({frames, static_cast<int64_t>(track->second.width)}, at::kFloat);
    for (int64_t t = 0; t < frames; ++t) {
      weights[t].copy_(at::tensor(track->second.at(static_cast<double>(t) / animation.fps)));
    }
    add_part(document, part, weights, animation.displacements);
  }
  if (tracks.turn || tracks.shift) {
    animation.head = at::empty({frames, 4, 4}, at::kDouble);
    for (int64_t t = 0; t < frames; ++t) {
      animation.head[t].copy_(tracks.pose_at(static_cast<double>(t) / animation.fps));
    }
  }
  animation.audio = read_sound(document);
  const json extras = document.root()["asset"].value("extras", json::object());
  if (extras.is_object() && extras.contains("metadata") && extras["metadata"].is_object()) {
    animation.metadata_json = extras["metadata"].dump();
  }
  animation.check();
  return animation;
}

}  // namespace

Animation load_gltf(const std::filesystem::path& path, double fps) {
  try {
    return read_motion(path, fps);
  } catch (const json::exception&) {
    throw std::runtime_error("animation file " + path.string() +
                             " is damaged or not glTF; export it again");
  }
}

}  // namespace freetalk::animation
