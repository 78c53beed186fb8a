// The glTF file that a mesh was read from, with motion added to what it shows.
#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>
#include <system_error>

#include "core/file.h"
#include "freetalk/core/error.h"
#include "gltf_parts.h"
#include "gltf_tracks.h"
#include "mesh/gltf_scene.h"
#include "morph_normals.h"

namespace freetalk::animation {
namespace {

namespace fs = std::filesystem;
using mesh::GltfDocument;
using mesh::GltfPart;

/// The file of a mesh, and which of the mesh's vertices stand for what in it.
struct Source {
  GltfDocument document;
  std::vector<GltfPart> parts;
};

/// Whether the file still holds the mesh as it was read.
bool still_the_same(const mesh::Mesh& mesh, const mesh::RawMesh& raw) {
  if (static_cast<int64_t>(raw.vertices.size()) != mesh.num_vertices() ||
      static_cast<int64_t>(raw.polygons.size()) != mesh.num_polygons()) {
    return false;
  }
  for (int64_t v = 0; v < mesh.num_vertices(); ++v) {
    if (mesh.vertices.row(v).transpose() != raw.vertices[v]) return false;
  }
  return true;
}

/// Nothing where the mesh was read from no glTF, or the file is another by now.
std::optional<Source> open_source(const mesh::Mesh& mesh) {
  const std::string extension = core::lower_extension(mesh.source);
  std::error_code error;
  const bool gltf = extension == "glb" || extension == "gltf";
  if (!gltf || !fs::is_regular_file(mesh.source, error)) return std::nullopt;
  try {
    Source source{GltfDocument(mesh.source, core::read_text(mesh.source)), {}};
    const bool same = still_the_same(mesh, mesh::read_gltf_scene(source.document, &source.parts));
    if (same) return source;
  } catch (const std::runtime_error&) {  // no glTF any more
  } catch (const nlohmann::json::exception&) {
  }
  return std::nullopt;
}

/// Adds targets to the primitives of the nodes that move, and an animation of their weights; where
/// the head moves, a node that carries the character.
class MotionInto {
 public:
  MotionInto(const GltfDocument& document, const FormerMotion& former, Json& root,
             GltfBuffer& buffer, const Animation& animation, const BlendShapes& shapes,
             bool with_normals)
      : document_(document),
        former_(former),
        root_(root),
        buffer_(buffer),
        animation_(animation),
        shapes_(shapes),
        normals_(animation.mesh),
        with_normals_(with_normals),
        tracks_(buffer, animation) {}

  void add(const std::vector<GltfPart>& parts) {
    add_shapes(parts);
    if (animation_.head.defined()) add_head(parts);
    if (tracks_.empty()) return;
    Json& all = root_["animations"];
    if (all.is_null()) all = Json::array();
    all.insert(all.begin(), tracks_.json());  // viewers play the first
  }

 private:
  void add_shapes(const std::vector<GltfPart>& parts) {
    const auto nodes = moving_nodes(parts);
    std::set<int64_t> grown;
    for (const auto& [node, own] : nodes) grown.insert(own.front().mesh);
    fit_other_animations(grown);  // before the targets: a later save finds those at the end
    for (const auto& [node, own] : nodes) add_node(node, own);
  }

  /// Parts by the nodes of which a vertex moves.
  std::map<int64_t, std::vector<GltfPart>> moving_nodes(const std::vector<GltfPart>& parts) const {
    std::map<int64_t, std::vector<GltfPart>> nodes;
    if (shapes_.names.empty()) return nodes;
    const auto moved = shapes_.targets.abs().amax(std::vector<int64_t>{0, 2}) > 0;  // (V,)
    for (const GltfPart& part : parts) nodes[part.node].push_back(part);
    std::erase_if(nodes, [&](const auto& entry) {
      return std::none_of(entry.second.begin(), entry.second.end(), [&](const GltfPart& part) {
        return part.node >= 0 && moved.slice(0, part.first_vertex, end_of(part)).any().item<bool>();
      });
    });
    return nodes;
  }

  /// Animations that were there say a weight for every target, of ours too. @param grown meshes
  /// that get targets.
  void fit_other_animations(const std::set<int64_t>& grown) {
    if (!root_.contains("animations")) return;
    for (Json& animation : root_["animations"]) {
      for (Json& channel : animation["channels"]) {
        const Json& target = channel["target"];
        if (target.value("path", "") != "weights" || !target.contains("node")) continue;
        const auto mesh =
            root_["nodes"].at(target["node"].get<size_t>()).value("mesh", int64_t{-1});
        const auto found = former_.targets.find(mesh);
        const auto gone = found == former_.targets.end() ? std::vector<bool>{} : found->second;
        const auto fresh = grown.count(mesh) > 0 ? static_cast<int64_t>(shapes_.names.size()) : 0;
        if (mesh < 0 || (gone.empty() && fresh == 0)) continue;
        Json& samplers = animation["samplers"];
        Json sampler = samplers.at(channel["sampler"].get<size_t>());
        sampler["output"] = fitted(sampler["output"].get<int64_t>(), mesh, gone, fresh);
        const auto shares = [&](const Json& other) {
          return other["sampler"] == channel["sampler"];
        };
        const auto& channels = animation["channels"];
        if (std::count_if(channels.begin(), channels.end(), shares) > 1) {
          channel["sampler"] = samplers.size();
          samplers.push_back(std::move(sampler));
        } else {
          samplers[channel["sampler"].get<size_t>()] = std::move(sampler);
        }
      }
    }
  }

  /// Weights without those of targets that are gone, and zeros for fresh ones. @return accessor.
  int fitted(int64_t accessor, int64_t mesh, std::vector<bool> gone, int64_t fresh) {
    const auto& primitives = document_.list("meshes").at(mesh).at("primitives");
    gone.resize(document_.list(primitives.at(0), "targets").size());
    std::vector<int64_t> kept;
    for (size_t k = 0; k < gone.size(); ++k) {
      if (!gone[k]) kept.push_back(static_cast<int64_t>(k));
    }
    const auto all = at::tensor(document_.accessor_numbers(accessor, 1)).to(at::kFloat);
    const auto columns = static_cast<int64_t>(gone.size());
    if (columns == 0 || all.size(0) % columns != 0) {
      document_.fail("has an animation that is damaged; export it again");
    }
    const auto before = all.view({-1, columns}).index_select(1, at::tensor(kept));
    const auto zeros = at::zeros({before.size(0), fresh});
    return buffer_.add(at::cat({before, zeros}, 1).reshape({-1, 1}), {"SCALAR"});
  }

  /// Whether a node or one below it shows a mesh, or is the joint of a skin.
  bool carries(size_t top, const std::set<size_t>& bearing) const {
    std::vector<size_t> waiting{top};
    while (!waiting.empty()) {
      const size_t node = waiting.back();
      waiting.pop_back();
      if (bearing.count(node) > 0) return true;
      const Json& json = root_["nodes"].at(node);
      if (!json.contains("children")) continue;
      for (const Json& child : json["children"]) waiting.push_back(child.get<size_t>());
    }
    return false;
  }

  /// Lamps and cameras stay where they are.
  void add_head(const std::vector<GltfPart>& parts) {
    std::set<size_t> bearing;
    for (const GltfPart& part : parts) bearing.insert(static_cast<size_t>(part.node));
    if (root_.contains("skins")) {
      for (const Json& skin : root_["skins"]) {
        for (const Json& joint : skin["joints"]) bearing.insert(joint.get<size_t>());
      }
    }
    const auto node = static_cast<int64_t>(root_["nodes"].size());
    Json& roots = root_["scenes"][root_.value("scene", size_t{0})]["nodes"];
    Json outside = Json::array(), carried = Json::array();
    for (const Json& top : roots) {
      (carries(top.get<size_t>(), bearing) ? carried : outside).push_back(top);
    }
    outside.push_back(node);
    roots = std::move(outside);
    root_["nodes"].push_back(head_json(std::move(carried)));
    tracks_.add_head(node, MeshFrame{});  // the mesh is in the file's own metres and axes
  }

  int64_t end_of(const GltfPart& part) const {
    return part.first_vertex + buffer_.accessors[part.positions]["count"].get<int64_t>();
  }

  void add_node(int64_t node, const std::vector<GltfPart>& parts) {
    int64_t index = parts.front().mesh;
    if (!used_.insert(index).second) {  // shown twice: each showing moves by itself
      root_["meshes"].push_back(untouched_.at(index));
      index = static_cast<int64_t>(root_["meshes"].size()) - 1;
      root_["nodes"][node]["mesh"] = index;
    } else {
      untouched_[index] = root_["meshes"][index];
    }
    Json& mesh = root_["meshes"][index];
    size_t own = 0;  // targets that were there
    for (const Json& primitive : mesh["primitives"]) {
      if (primitive.contains("targets")) own = std::max(own, primitive["targets"].size());
    }
    std::map<std::pair<int64_t, bool>, Json> known;  // targets by positions and normals
    for (const GltfPart& part : parts) {
      Json& primitive = mesh["primitives"][part.primitive];
      const bool normals = with_normals_ && primitive["attributes"].contains("NORMAL");
      const auto [found, fresh] = known.try_emplace({part.positions, normals});
      if (fresh) found->second = targets_of(part, normals);
      Json& targets = primitive["targets"];
      if (targets.is_null()) targets = Json::array();
      for (const Json& target : found->second) targets.push_back(target);
    }
    name_targets(mesh, own);
    animate(node, add_rest_weights(node, mesh, own), own);
  }

  Json targets_of(const GltfPart& part, bool normals) {
    const auto linear = at::empty({3, 3}, at::kDouble);
    const Eigen::Matrix3d back = part.linear.inverse();
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) linear[c][r] = back(r, c);  // rows of displacements
    }
    // Normals go the way of the transposed inverse; of a part that is only turned and scaled that
    // is its rotation.
    const double scale = std::cbrt(std::abs(part.linear.determinant()));
    const auto turn = (linear * scale).to(at::kFloat);
    const auto matrix = linear.to(at::kFloat);
    Json targets = Json::array();
    for (int64_t k = 0; k < shapes_.targets.size(0); ++k) {
      const auto rows = [&](const at::Tensor& values, const at::Tensor& map) {
        return values.slice(0, part.first_vertex, end_of(part)).matmul(map);
      };
      Json target;
      target["POSITION"] =
          buffer_.add(rows(shapes_.targets[k], matrix), {"VEC3", kArrayBuffer, true});
      if (normals) {
        target["NORMAL"] = buffer_.add(rows(derivative(k), turn), {"VEC3", kArrayBuffer});
      }
      targets.push_back(std::move(target));
    }
    return targets;
  }

  const at::Tensor& derivative(int64_t k) {
    at::Tensor& found = derivatives_[k];
    if (!found.defined()) found = normals_.derivative(shapes_.targets[k]);
    return found;
  }

  void name_targets(Json& mesh, size_t own) const {
    Json& extras = mesh["extras"];
    Json& names = extras["targetNames"];
    if (names.is_null()) names = Json::array();
    while (names.size() < own) names.push_back("target_" + std::to_string(names.size()));
    std::set<std::string> taken;
    for (const Json& name : names) taken.insert(name.is_string() ? name.get<std::string>() : "");
    Json ours = Json::array();
    for (const std::string& name : shapes_.names) {
      names.push_back(taken.count(name) > 0 ? "talk_" + name : name);
      ours.push_back(names.back());
    }
    extras[kOurTargets] = std::move(ours);
  }

  /// @return weights at rest of all targets as the node shows them.
  const Json& add_rest_weights(int64_t node, Json& mesh, size_t own) {
    Json& shown = root_["nodes"][node];
    for (Json* weights :
         {&mesh["weights"], shown.contains("weights") ? &shown["weights"] : nullptr}) {
      if (weights == nullptr) continue;
      if (weights->is_null()) *weights = Json::array();
      while (weights->size() < own + shapes_.names.size()) weights->push_back(0.0);
    }
    return shown.contains("weights") ? shown["weights"] : mesh["weights"];
  }

  /// The targets that were there keep the weight they have at rest.
  void animate(int64_t node, const Json& rest, size_t own) {
    at::Tensor weights = shapes_.weights;
    if (own > 0) {
      std::vector<float> still;
      for (size_t k = 0; k < own; ++k) still.push_back(rest[k].get<float>());
      const auto before = at::tensor(still).expand({animation_.num_frames(), -1});
      weights = at::cat({before, weights}, 1);
    }
    tracks_.add(node, "weights", weights.reshape({-1, 1}), "SCALAR");
  }

  const GltfDocument& document_;
  const FormerMotion& former_;
  Json& root_;
  GltfBuffer& buffer_;
  const Animation& animation_;
  const BlendShapes& shapes_;
  const MorphNormals normals_;
  const bool with_normals_;
  GltfTracks tracks_;
  std::set<int64_t> used_;
  std::map<int64_t, Json> untouched_;
  std::map<int64_t, at::Tensor> derivatives_;
};

/// Where the last view of each buffer ends.
std::vector<size_t> ends_of_views(const Json& root, size_t buffers) {
  std::vector<size_t> ends(buffers, 0);
  for (const Json& view : root.value("bufferViews", Json::array())) {
    size_t& end = ends.at(view.value("buffer", size_t{0}));
    end = std::max(end, view.value("byteOffset", size_t{0}) + view.at("byteLength").get<size_t>());
  }
  return ends;
}

/// The file's buffers become the beginning of ours, pictures in other files a part of it.
/// @param cut whether what is behind their last views is left out.
GltfBuffer take_buffers(const GltfDocument& document, Json& root, bool cut) {
  GltfBuffer buffer;
  std::vector<int64_t> begins;
  const auto& all = document.buffers();
  std::vector<size_t> ends;
  if (cut) ends = ends_of_views(root, all.size());
  for (size_t b = 0; b < all.size(); ++b) {
    begins.push_back(buffer.append(cut ? all[b].substr(0, ends[b]) : all[b]));
  }
  if (root.contains("bufferViews")) buffer.views = root["bufferViews"];
  if (root.contains("accessors")) buffer.accessors = root["accessors"];
  for (Json& view : buffer.views) {
    const auto index = view.value("buffer", size_t{0});
    if (index >= begins.size()) document.fail("is damaged or cut short; export it again");
    view["byteOffset"] = view.value("byteOffset", int64_t{0}) + begins[index];
    view["buffer"] = 0;
  }
  if (!root.contains("images")) return buffer;
  for (Json& image : root["images"]) {
    if (!image.contains("uri")) continue;
    const std::string uri = image["uri"].get<std::string>();
    const std::string bytes = document.content_of(uri);
    const bool png = bytes.compare(0, 4, "\x89PNG") == 0;
    image["bufferView"] = buffer.add_bytes(bytes);
    image["mimeType"] = png ? "image/png" : "image/jpeg";
    image.erase("uri");
  }
  return buffer;
}

}  // namespace

bool save_into_source(const std::filesystem::path& path, const Animation& animation,
                      const BlendShapes& shapes, const SaveOptions& options, SaveReport& report) {
  const std::optional<Source> source = open_source(animation.mesh);
  if (!source) return false;
  Json root = source->document.root();
  if (!root.contains("scenes") || !root.contains("nodes")) return false;  // nothing to animate
  GltfBuffer buffer;
  try {
    const FormerMotion former = remove_former_motion(root);
    buffer = take_buffers(source->document, root, former.found);
    MotionInto(source->document, former, root, buffer, animation, shapes, options.normals)
        .add(source->parts);
  } catch (const nlohmann::json::exception&) {
    source->document.fail("is damaged or cut short; export it again");
  } catch (const std::out_of_range&) {
    source->document.fail("is damaged or cut short; export it again");
  }
  add_facts(root, animation, Json::parse(animation.metadata_json));
  if (options.sound && !animation.audio.samples.empty()) add_sound(root, buffer, animation, path);
  report.num_files = write_gltf(path, std::move(root), buffer);
  report.into_source = true;
  return true;
}

}  // namespace freetalk::animation
