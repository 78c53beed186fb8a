#include "gltf.h"

#include <ATen/ATen.h>
#include <Eigen/Geometry>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include "core/file.h"
#include "freetalk/animation/morph.h"
#include "freetalk/core/error.h"
#include "freetalk/geometry/surface.h"
#include "freetalk/mesh/normals.h"

namespace freetalk::animation {
namespace {

using nlohmann::ordered_json;

constexpr int kFloat = 5126, kUnsignedInt = 5125;
constexpr int kFaceNode = 0, kHeadNode = 1;  // the head moves the face, where it moves
constexpr int kArrayBuffer = 34962, kElementArrayBuffer = 34963;

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

/// Collects buffer views; their bytes stay where they are until written.
class Buffer {
 public:
  ordered_json views = ordered_json::array(), accessors = ordered_json::array();

  /// Adds an accessor over `data` (float32 or int32 bits as uint32), contiguous. @return its index.
  int add(at::Tensor data, const std::string& type, int component, int target, bool bounds) {
    data = data.contiguous();
    const int64_t bytes = data.numel() * 4;
    ordered_json view = {{"buffer", 0}, {"byteOffset", bytes_}, {"byteLength", bytes}};
    if (target != 0) view["target"] = target;
    views.push_back(view);
    ordered_json accessor = {{"bufferView", views.size() - 1},
                             {"componentType", component},
                             {"count", type == "SCALAR" ? data.numel() : data.size(0)},
                             {"type", type}};
    if (bounds) {
      const auto flat = data.view({data.size(0), -1});
      const auto list = [](const at::Tensor& values) {
        const auto wide = values.to(at::kDouble).contiguous();
        return std::vector<double>(wide.data_ptr<double>(), wide.data_ptr<double>() + wide.numel());
      };
      accessor["min"] = list(std::get<0>(flat.min(0)));
      accessor["max"] = list(std::get<0>(flat.max(0)));
    }
    accessors.push_back(accessor);
    bytes_ += bytes;
    blocks_.push_back(std::move(data));
    return static_cast<int>(accessors.size()) - 1;
  }

  int64_t bytes() const { return bytes_; }

  void write(std::ostream& out) const {
    for (const auto& block : blocks_) {
      out.write(static_cast<const char*>(block.data_ptr()), block.numel() * 4);
    }
  }

 private:
  int64_t bytes_ = 0;
  std::vector<at::Tensor> blocks_;
};

at::Tensor to_tensor(const Eigen::MatrixXd& matrix) {
  const Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> rows =
      matrix.cast<float>();
  return at::from_blob(const_cast<float*>(rows.data()), {rows.rows(), rows.cols()}, at::kFloat)
      .clone();
}

ordered_json mesh_json(const Animation& animation, const MorphBasis& basis, Buffer& buffer) {
  const auto& mesh = animation.mesh;
  Corners corners = make_corners(mesh);
  const auto source = at::tensor(corners.source, at::kInt);
  const auto per_corner = [&](const at::Tensor& values) { return values.index_select(0, source); };
  ordered_json attributes;
  attributes["POSITION"] =
      buffer.add(per_corner(to_tensor(mesh.vertices)), "VEC3", kFloat, kArrayBuffer, true);
  attributes["NORMAL"] =
      buffer.add(per_corner(to_tensor(mesh::vertex_normals(mesh.vertices, mesh.faces))), "VEC3",
                 kFloat, kArrayBuffer, false);
  if (!corners.texcoords.empty()) {
    attributes["TEXCOORD_0"] = buffer.add(at::tensor(corners.texcoords).view({-1, 2}), "VEC2",
                                          kFloat, kArrayBuffer, false);
  }
  const std::vector<int32_t> triangles(corners.triangles.begin(), corners.triangles.end());
  const int indices = buffer.add(at::tensor(triangles, at::kInt), "SCALAR", kUnsignedInt,
                                 kElementArrayBuffer, false);
  ordered_json primitive = {{"attributes", attributes}, {"indices", indices}, {"material", 0}};
  ordered_json names = ordered_json::array();
  for (int64_t k = 0; k < basis.targets.size(0); ++k) {
    primitive["targets"].push_back({{"POSITION", buffer.add(per_corner(basis.targets[k]), "VEC3",
                                                            kFloat, kArrayBuffer, true)}});
    names.push_back("motion_" + std::to_string(k));
  }
  ordered_json result = {{"name", mesh.name.empty() ? "face" : mesh.name},
                         {"primitives", ordered_json::array({primitive})}};
  if (!names.empty()) {
    result["weights"] = std::vector<double>(names.size(), 0.0);
    result["extras"] = {{"targetNames", names}};
  }
  return result;
}

/// Rotation (T, 4) as quaternions x, y, z, w and translation (T, 3) of the head in glTF's metres
/// and axes.
std::pair<at::Tensor, at::Tensor> head_tracks(const Animation& animation) {
  const int64_t frames = animation.num_frames();
  const at::Tensor turns = at::empty({frames, 4}), shifts = at::empty({frames, 3});
  const Eigen::Matrix3d& up = animation.frame.to_y_up;
  Eigen::Vector4d before = Eigen::Quaterniond::Identity().coeffs();
  using Pose = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;
  for (int64_t t = 0; t < frames; ++t) {
    const Pose pose = Eigen::Map<const Pose>(animation.head.const_data_ptr<double>() + 16 * t);
    const Eigen::Matrix3d turn = up * pose.topLeftCorner<3, 3>() * up.transpose();
    Eigen::Vector4d coefficients = Eigen::Quaterniond(turn).coeffs();
    if (coefficients.dot(before) < 0) coefficients = -coefficients;  // the same turn, the short way
    before = coefficients;
    Eigen::Map<Eigen::Vector4f>(turns.data_ptr<float>() + 4 * t) = coefficients.cast<float>();
    const Eigen::Vector3d shift =
        animation.frame.metres_per_unit * (up * pose.topRightCorner<3, 1>());
    Eigen::Map<Eigen::Vector3f>(shifts.data_ptr<float>() + 3 * t) = shift.cast<float>();
  }
  return {turns, shifts};
}

ordered_json animation_json(const Animation& animation, const MorphBasis& basis, Buffer& buffer) {
  const auto times =
      at::arange(animation.num_frames(), at::kDouble).div(animation.fps).to(at::kFloat);
  const int input = buffer.add(times.view({-1, 1}), "SCALAR", kFloat, 0, true);
  ordered_json samplers = ordered_json::array(), channels = ordered_json::array();
  const auto add = [&](const char* path, int node, const at::Tensor& values, const char* type) {
    const int output = buffer.add(values, type, kFloat, 0, false);
    channels.push_back(
        {{"sampler", samplers.size()}, {"target", {{"node", node}, {"path", path}}}});
    samplers.push_back({{"input", input}, {"interpolation", "LINEAR"}, {"output", output}});
  };
  if (basis.targets.size(0) > 0) add("weights", kFaceNode, basis.weights.view({-1}), "SCALAR");
  if (animation.head.defined()) {
    const auto [turns, shifts] = head_tracks(animation);
    add("rotation", kHeadNode, turns, "VEC4");
    add("translation", kHeadNode, shifts, "VEC3");
  }
  return {{"name", "talk"}, {"samplers", samplers}, {"channels", channels}};
}

ordered_json node_json(const Animation& animation) {
  const Eigen::Quaterniond turn(animation.frame.to_y_up);
  const double scale = animation.frame.metres_per_unit;
  ordered_json node = {{"name", "face"}, {"mesh", 0}};
  node["rotation"] = {turn.x(), turn.y(), turn.z(), turn.w()};
  node["scale"] = {scale, scale, scale};
  return node;
}

ordered_json document(const Animation& animation, const MorphBasis& basis, Buffer& buffer) {
  ordered_json root;
  root["asset"] = {{"version", "2.0"}, {"generator", "freetalk"}};
  root["asset"]["extras"] = {{"fps", animation.fps},
                             {"metadata", ordered_json::parse(animation.metadata_json)}};
  const bool moves = animation.head.defined();
  root["scene"] = 0;
  root["scenes"] = ordered_json::array({{{"nodes", {moves ? kHeadNode : kFaceNode}}}});
  root["nodes"] = ordered_json::array({node_json(animation)});
  if (moves) root["nodes"].push_back({{"name", "head"}, {"children", {kFaceNode}}});
  root["materials"] = ordered_json::array({{{"name", "skin"},
                                            {"doubleSided", true},
                                            {"pbrMetallicRoughness",
                                             {{"baseColorFactor", {0.80, 0.64, 0.56, 1.0}},
                                              {"metallicFactor", 0.0},
                                              {"roughnessFactor", 0.7}}}}});
  root["meshes"] = ordered_json::array({mesh_json(animation, basis, buffer)});
  if (basis.targets.size(0) > 0 || moves) {
    root["animations"] = ordered_json::array({animation_json(animation, basis, buffer)});
  }
  root["accessors"] = buffer.accessors;
  root["bufferViews"] = buffer.views;
  root["buffers"] = ordered_json::array({{{"byteLength", buffer.bytes()}}});
  return root;
}

void put_u32(std::ostream& out, uint64_t value) {
  const char bytes[4] = {static_cast<char>(value), static_cast<char>(value >> 8),
                         static_cast<char>(value >> 16), static_cast<char>(value >> 24)};
  out.write(bytes, 4);
}

void write_glb(const std::filesystem::path& path, const ordered_json& root, const Buffer& buffer) {
  std::string json = root.dump();
  json.append((4 - json.size() % 4) % 4, ' ');
  const uint64_t total = 12 + 8 + json.size() + 8 + buffer.bytes();
  FREETALK_RUNTIME_CHECK(
      total <= UINT32_MAX, path.string(),
      ": would exceed the 4 GB of a .glb; lower max_morph_targets or write .npz");
  core::write_file_atomic(path, [&](std::ostream& out) {
    out.write("glTF", 4);
    put_u32(out, 2);
    put_u32(out, total);
    put_u32(out, json.size());
    out.write("JSON", 4);
    out.write(json.data(), static_cast<std::streamsize>(json.size()));
    put_u32(out, buffer.bytes());
    out.write("BIN\0", 4);
    buffer.write(out);
  });
}

}  // namespace

SaveReport save_gltf(const std::filesystem::path& path, const Animation& animation,
                     const SaveOptions& options) {
  const double unit_mm = 1e3 * animation.frame.metres_per_unit;
  const auto basis = morph_basis(animation.displacements, options.morph_tolerance_mm / unit_mm,
                                 options.max_morph_targets);
  Buffer buffer;
  ordered_json root = document(animation, basis, buffer);
  SaveReport report;
  report.num_morph_targets = basis.targets.size(0);
  report.morph_error_mm = basis.max_error * unit_mm;
  if (core::lower_extension(path) == "glb") {
    report.format = "glb";
    write_glb(path, root, buffer);
    return report;
  }
  report.format = "gltf";
  report.num_files = 2;
  const auto binary = std::filesystem::path(path).replace_extension(".bin");
  root["buffers"][0]["uri"] = binary.filename().string();
  core::write_file_atomic(binary, [&](std::ostream& out) { buffer.write(out); });
  core::write_file_atomic(path, root.dump());
  return report;
}

}  // namespace freetalk::animation
