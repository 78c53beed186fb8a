#include "gltf.h"

#include <ATen/ATen.h>
#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include "core/file.h"
#include "file_metadata.h"
#include "freetalk/mesh/appearance.h"
#include "gltf_file.h"
#include "gltf_parts.h"
#include "gltf_tracks.h"
#include "morph_normals.h"
#include "sound.h"

namespace freetalk::animation {
namespace {

constexpr int64_t kFaceNode = 0, kHeadNode = 1;  // the head moves the face, where it moves

/// The vertices of the file: the mesh's own, then copies for further texture coordinates.
struct Corners {
  std::vector<int32_t> source;      // (V',) vertex of the mesh
  std::vector<uint32_t> triangles;  // (3F,)
  std::vector<float> texcoords;     // (2V',) glTF's convention (v down); empty without
};

/// For every corner of every triangle its row of mesh.texcoords, -1 if it has none.
std::vector<int> corner_texcoords(const mesh::Mesh& mesh) {
  std::vector<int> rows(3 * mesh.num_faces(), -1);
  for (int64_t f = 0; f < mesh.num_faces(); ++f) {
    const int64_t index = mesh.polygons.empty() ? f : mesh.face_polygon.at(f);
    const auto& polygon_rows = mesh.polygon_texcoords.at(index);
    const auto polygon = mesh.polygon(index);
    if (polygon_rows.size() != polygon.size()) continue;
    for (int k = 0; k < 3; ++k) {
      const auto found = std::find(polygon.begin(), polygon.end(), mesh.faces(f, k));
      if (found != polygon.end()) rows[3 * f + k] = polygon_rows[found - polygon.begin()];
    }
  }
  return rows;
}

Corners make_corners(const mesh::Mesh& mesh) {
  Corners corners;
  const int64_t vertices = mesh.num_vertices();
  for (int64_t v = 0; v < vertices; ++v) corners.source.push_back(static_cast<int32_t>(v));
  for (int64_t f = 0; f < mesh.num_faces(); ++f) {
    for (int k = 0; k < 3; ++k) corners.triangles.push_back(mesh.faces(f, k));
  }
  if (mesh.texcoords.rows() == 0 || mesh.polygon_texcoords.empty()) return corners;
  const auto rows = corner_texcoords(mesh);
  const auto uv_of = [&](int row) {
    return std::pair{static_cast<float>(mesh.texcoords(row, 0)),
                     static_cast<float>(1.0 - mesh.texcoords(row, 1))};
  };
  std::vector<std::pair<float, float>> uv(vertices, {0.0f, 0.0f});
  std::vector<bool> taken(vertices, false);
  std::map<std::pair<uint32_t, std::pair<float, float>>, uint32_t> copies;
  for (size_t c = 0; c < rows.size(); ++c) {
    if (rows[c] < 0) continue;
    uint32_t& vertex = corners.triangles[c];
    const auto wanted = uv_of(rows[c]);
    if (!taken[vertex]) {
      taken[vertex] = true;
      uv[vertex] = wanted;
    } else if (uv[vertex] != wanted) {
      const auto [found, fresh] =
          copies.try_emplace({vertex, wanted}, static_cast<uint32_t>(corners.source.size()));
      if (fresh) {
        corners.source.push_back(static_cast<int32_t>(vertex));
        uv.push_back(wanted);
      }
      vertex = found->second;
    }
  }
  for (const auto& [u, v] : uv) corners.texcoords.insert(corners.texcoords.end(), {u, v});
  return corners;
}

at::Tensor to_tensor(const Eigen::MatrixXd& matrix) {
  const Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> rows =
      matrix.cast<float>();
  return at::from_blob(const_cast<float*>(rows.data()), {rows.rows(), rows.cols()}, at::kFloat)
      .clone();
}

constexpr double kSteps = 32767.0;

/// Vertices and targets as the file holds them: as they are, or on a grid of 16 bits around the
/// middle of the mesh.
struct Grid {
  Eigen::RowVector3d middle = Eigen::RowVector3d::Zero();
  double half = 1.0;  // the mesh's own units at the end of the grid
  bool compact = false;

  at::Tensor pack(const at::Tensor& values) const {
    if (!compact) return values;
    return (values * (kSteps / half)).round().clamp(-kSteps, kSteps).to(at::kShort);
  }
};

Grid grid_of(const Animation& animation, const BlendShapes& shapes, bool compact) {
  Grid grid;
  if (!compact) return grid;
  const Eigen::MatrixXd& vertices = animation.mesh.vertices;
  grid.compact = true;
  grid.middle = 0.5 * (vertices.colwise().minCoeff() + vertices.colwise().maxCoeff());
  grid.half = (vertices.rowwise() - grid.middle).cwiseAbs().maxCoeff();
  if (shapes.targets.size(0) > 0) {
    grid.half = std::max(grid.half, shapes.targets.abs().max().item<double>());
  }
  grid.half = std::max(grid.half, 1e-30);
  return grid;
}

/// Numbers in [-1, 1] in 16 bits, or 8.
at::Tensor pack_signed(const at::Tensor& values, at::ScalarType type) {
  const double steps = type == at::kChar ? 127.0 : kSteps;
  return (values.clamp(-1.0, 1.0) * steps).round().to(type);
}

/// (V, 4) linear uint16 of sRGB in [0, 1].
at::Tensor linear_colours(const Eigen::MatrixXd& colours) {
  Eigen::MatrixXd linear = colours;
  for (int c = 0; c < 3; ++c) {
    linear.col(c) = colours.col(c).unaryExpr(
        [](double v) { return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4); });
  }
  return to_tensor(65535.0 * linear).round().to(at::kInt).to(at::kUInt16);
}

Json attributes_json(const Animation& animation, const mesh::Appearance& look,
                     const Corners& corners, const at::Tensor& rest_normals, const Grid& grid,
                     const at::Tensor& source, GltfBuffer& buffer) {
  const auto& mesh = animation.mesh;
  const auto rest = grid.pack(to_tensor(mesh.vertices.rowwise() - grid.middle));
  Json attributes;
  attributes["POSITION"] =
      buffer.add(rest.index_select(0, source), {"VEC3", kArrayBuffer, true, grid.compact});
  const auto normals = grid.compact ? pack_signed(rest_normals, at::kShort) : rest_normals;
  attributes["NORMAL"] =
      buffer.add(normals.index_select(0, source), {"VEC3", kArrayBuffer, false, grid.compact});
  if (!corners.texcoords.empty()) {
    attributes["TEXCOORD_0"] =
        buffer.add(at::tensor(corners.texcoords).view({-1, 2}), {"VEC2", kArrayBuffer});
  }
  if (look.colours.rows() > 0) {
    const auto colours = linear_colours(look.colours);
    const auto of_corners = colours.view(at::kShort).index_select(0, source).view(at::kUInt16);
    attributes["COLOR_0"] = buffer.add(of_corners, {"VEC4", kArrayBuffer, false, true});
  }
  return attributes;
}

Json targets_json(const BlendShapes& shapes, const MorphNormals& normals, const Grid& grid,
                  const at::Tensor& source, bool with_normals, GltfBuffer& buffer) {
  Json targets = Json::array();
  for (int64_t k = 0; k < shapes.targets.size(0); ++k) {
    Json target;
    const auto moved = grid.pack(shapes.targets[k]);
    target["POSITION"] =
        buffer.add(moved.index_select(0, source), {"VEC3", kArrayBuffer, true, grid.compact});
    if (with_normals) {
      auto turned = normals.derivative(shapes.targets[k]);
      if (grid.compact) turned = pack_signed(turned, at::kChar);  // light shows no finer steps
      target["NORMAL"] =
          buffer.add(turned.index_select(0, source), {"VEC3", kArrayBuffer, false, grid.compact});
    }
    targets.push_back(std::move(target));
  }
  return targets;
}

/// Corners of the triangles of each material, -1 first.
std::map<int, std::vector<int32_t>> by_material(const mesh::Mesh& mesh,
                                                const mesh::Appearance& look,
                                                const Corners& corners) {
  std::map<int, std::vector<int32_t>> groups;
  for (int64_t f = 0; f < mesh.num_faces(); ++f) {
    const int64_t polygon = mesh.polygons.empty() ? f : mesh.face_polygon.at(f);
    auto& group = groups[look.materials.empty() ? -1 : look.polygon_material.at(polygon)];
    for (int k = 0; k < 3; ++k) {
      group.push_back(static_cast<int32_t>(corners.triangles[3 * f + k]));
    }
  }
  return groups;
}

Json material_json(const mesh::Material& material, int texture) {
  const auto& c = material.colour;
  Json pbr = {{"baseColorFactor", {c[0], c[1], c[2], c[3]}},
              {"metallicFactor", 0.0},
              {"roughnessFactor", 0.7}};
  if (texture >= 0) pbr["baseColorTexture"] = {{"index", texture}};
  Json json = {{"name", material.name}, {"doubleSided", true}, {"pbrMetallicRoughness", pbr}};
  if (c[3] < 1.0) json["alphaMode"] = "BLEND";
  return json;
}

/// Materials and their textures; the last is for polygons that have none.
void add_materials(Json& root, const mesh::Appearance& look, GltfBuffer& buffer) {
  root["materials"] = Json::array();
  std::map<std::string, int> known;  // textures by content
  for (const auto& material : look.materials) {
    int texture = -1;
    if (!material.texture.bytes.empty()) {
      const auto [found, fresh] =
          known.try_emplace(material.texture.bytes, static_cast<int>(known.size()));
      texture = found->second;
      if (fresh) {
        root["images"].push_back({{"name", material.texture.name},
                                  {"bufferView", buffer.add_bytes(material.texture.bytes)},
                                  {"mimeType", material.texture.media_type}});
        root["textures"].push_back({{"source", texture}});
      }
    }
    root["materials"].push_back(material_json(material, texture));
  }
  mesh::Material skin;
  skin.name = "skin";
  if (look.colours.rows() == 0) skin.colour = Eigen::Vector4d(0.80, 0.64, 0.56, 1.0);
  root["materials"].push_back(material_json(skin, -1));
}

Json mesh_json(const Animation& animation, const BlendShapes& shapes, const mesh::Appearance& look,
               const Grid& grid, const SaveOptions& options, GltfBuffer& buffer) {
  const auto& mesh = animation.mesh;
  const Corners corners = make_corners(mesh);
  const auto source = at::tensor(corners.source, at::kInt);
  const MorphNormals normals(mesh);
  const Json attributes =
      attributes_json(animation, look, corners, normals.rest(), grid, source, buffer);
  const Json targets = targets_json(shapes, normals, grid, source, options.normals, buffer);
  Json primitives = Json::array();
  for (const auto& [material, triangles] : by_material(mesh, look, corners)) {
    const auto indices = at::tensor(triangles, at::kInt).view({-1, 1});
    const bool small = options.compact && corners.source.size() < 65535;
    Json primitive = {
        {"attributes", attributes},
        {"indices",
         buffer.add(small ? indices.to(at::kUInt16) : indices, {"SCALAR", kElementArrayBuffer})},
        {"material", material >= 0 ? material : static_cast<int>(look.materials.size())}};
    if (!targets.empty()) primitive["targets"] = targets;
    primitives.push_back(std::move(primitive));
  }
  Json result = {{"name", mesh.name.empty() ? "face" : mesh.name}, {"primitives", primitives}};
  if (!targets.empty()) {
    result["weights"] = std::vector<double>(shapes.names.size(), 0.0);
    result["extras"] = {{"targetNames", shapes.names}};
  }
  return result;
}

Json node_json(const Animation& animation, const Grid& grid) {
  const Eigen::Quaterniond turn(animation.frame.to_y_up);
  const double scale = animation.frame.metres_per_unit;
  const Eigen::Vector3d shift = scale * (animation.frame.to_y_up * grid.middle.transpose());
  Json node = {{"name", "face"}, {"mesh", 0}};
  if (grid.compact) node["translation"] = {shift.x(), shift.y(), shift.z()};
  node["rotation"] = {turn.x(), turn.y(), turn.z(), turn.w()};
  node["scale"] = std::vector<double>(3, scale * grid.half);
  return node;
}

/// What 16 bits cost: the targets as they come back, and the rest pose.
double compact_error(const Animation& animation, const BlendShapes& shapes, const Grid& grid) {
  const double step = grid.half / kSteps;
  const auto targets = grid.pack(shapes.targets).to(at::kFloat) * step;
  return morph_error(animation.displacements, shapes.weights, targets) + std::sqrt(3.0) / 2 * step;
}

Json document(const Animation& animation, const BlendShapes& shapes, const Grid& grid,
              const SaveOptions& options, GltfBuffer& buffer) {
  const mesh::Appearance look = mesh::load_appearance(animation.mesh);
  Json root;
  root["asset"] = {{"version", "2.0"}, {"generator", kGenerator}};
  add_facts(root, animation, metadata_in_metres(animation));
  const bool moves = animation.head.defined();
  root["scene"] = 0;
  root["scenes"] = Json::array({{{"nodes", {moves ? kHeadNode : kFaceNode}}}});
  root["nodes"] = Json::array({node_json(animation, grid)});
  if (moves) root["nodes"].push_back(head_json({kFaceNode}));
  add_materials(root, look, buffer);
  root["meshes"] = Json::array({mesh_json(animation, shapes, look, grid, options, buffer)});
  GltfTracks tracks(buffer, animation);
  if (!shapes.names.empty()) {
    tracks.add(kFaceNode, "weights", shapes.weights.reshape({-1, 1}), "SCALAR");
  }
  if (moves) tracks.add_head(kHeadNode, animation.frame);
  if (!tracks.empty()) root["animations"] = Json::array({tracks.json()});
  if (grid.compact) {
    use_extension(root, "extensionsUsed", "KHR_mesh_quantization");
    use_extension(root, "extensionsRequired", "KHR_mesh_quantization");
  }
  return root;
}

}  // namespace

Json head_json(Json carried) {
  return {
      {"name", "head"}, {"children", std::move(carried)}, {"extras", {{"generator", kGenerator}}}};
}

void use_extension(Json& root, const char* list, const char* name) {
  Json& names = root[list];
  if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
}

void add_facts(Json& root, const Animation& animation, Json metadata) {
  root["asset"]["extras"]["fps"] = animation.fps;
  root["asset"]["extras"]["metadata"] = std::move(metadata);
}

void add_sound(Json& root, GltfBuffer& buffer, const Animation& animation,
               const std::filesystem::path& path) {
  Json sound = {{"mimeType", "audio/wav"}};
  if (core::lower_extension(path) == "glb") {
    sound["bufferView"] = buffer.add_bytes(wav_bytes(animation.audio));
  } else {
    sound["uri"] = uri_of(sound_beside(path));
  }
  Json& all = root["extensions"][kAudioExtension];
  const size_t audio = all["audio"].size(), source = all["sources"].size();
  const size_t emitter = all["emitters"].size();
  all["audio"].push_back(sound);
  all["sources"].push_back({{"name", "speech"}, {"audio", audio}, {"autoplay", true}});
  all["emitters"].push_back({{"name", "speech"},
                             {"type", "global"},
                             {"sources", {source}},
                             {"extras", {{"generator", kGenerator}}}});
  if (root.contains("scenes") && !root["scenes"].empty()) {
    const size_t scene = root.value("scene", size_t{0});
    root["scenes"][scene]["extensions"][kAudioExtension]["emitters"].push_back(emitter);
  }
  use_extension(root, "extensionsUsed", kAudioExtension);
}

SaveReport save_gltf(const std::filesystem::path& path, const Animation& animation,
                     const BlendShapes& shapes, const SaveOptions& options) {
  SaveReport report;
  report.format = core::lower_extension(path);
  report.num_morph_targets = shapes.targets.size(0);
  const double unit_mm = 1e3 * animation.frame.metres_per_unit;
  report.morph_error_mm = shapes.max_error * unit_mm;
  if (save_into_source(path, animation, shapes, options, report)) return report;
  const Grid grid = grid_of(animation, shapes, options.compact);
  if (grid.compact) report.morph_error_mm = compact_error(animation, shapes, grid) * unit_mm;
  GltfBuffer buffer;
  Json root = document(animation, shapes, grid, options, buffer);
  if (options.sound && !animation.audio.samples.empty()) add_sound(root, buffer, animation, path);
  report.num_files = write_gltf(path, std::move(root), buffer);
  return report;
}

}  // namespace freetalk::animation
