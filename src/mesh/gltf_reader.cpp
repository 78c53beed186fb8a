// glTF 2.0 and GLB to RawMesh: the triangles of every mesh the scene shows, moved by its nodes.
// Skins, animations and morph targets are left aside: the shape is the one at rest.
#include <Eigen/Geometry>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>

#include "freetalk/core/error.h"
#include "mesh/gltf_scene.h"

namespace freetalk::mesh {
namespace {

using nlohmann::json;

enum Mode { kPoints, kLines, kLineLoop, kLineStrip, kTriangles, kTriangleStrip, kTriangleFan };

class GltfScene {
 public:
  explicit GltfScene(const GltfDocument& document)
      : document_(document),
        nodes_(document.list("nodes")),
        meshes_(document.list("meshes")),
        visited_(nodes_.size(), 0) {}

  const std::vector<GltfPart>& parts() const { return parts_; }

  RawMesh read() {
    const std::vector<int64_t> roots = root_nodes();
    for (const int64_t root : roots) visit(root);
    if (nodes_.empty()) {
      for (size_t m = 0; m < meshes_.size(); ++m) {
        add_mesh(-1, static_cast<int64_t>(m), Eigen::Affine3d::Identity());
      }
    }
    if (mesh_.texcoords.empty()) mesh_.polygon_texcoords.clear();
    if (document_.list("materials").empty()) mesh_.polygon_material.clear();
    if (!mesh_.colours.empty())
      mesh_.colours.resize(mesh_.vertices.size(), Eigen::Vector4d::Ones());
    return std::move(mesh_);
  }

 private:
  /// First row by accessor: the primitives of a mesh may share vertices.
  struct Rows {
    std::map<int64_t, int> vertices;
    std::map<int64_t, int> texcoords;
  };

  [[noreturn]] void fail(const std::string& problem) const { document_.fail(problem); }

  /// Those of the scene shown first; without scenes every node that is nobody's child.
  std::vector<int64_t> root_nodes() const {
    const json& scenes = document_.list("scenes");
    std::vector<int64_t> roots;
    if (!scenes.empty()) {
      const int64_t scene = document_.index(document_.root(), "scene", scenes.size(), 0);
      return document_.indices(scenes[static_cast<size_t>(scene)], "nodes", nodes_.size());
    }
    std::vector<char> is_child(nodes_.size(), 0);
    for (const json& node : nodes_) {
      for (const int64_t child : document_.indices(node, "children", nodes_.size())) {
        is_child[static_cast<size_t>(child)] = 1;
      }
    }
    for (size_t n = 0; n < nodes_.size(); ++n) {
      if (!is_child[n]) roots.push_back(static_cast<int64_t>(n));
    }
    return roots;
  }

  /// Adds the meshes of a node and of all below it.
  void visit(int64_t root) {
    std::vector<std::pair<int64_t, Eigen::Affine3d>> waiting{{root, Eigen::Affine3d::Identity()}};
    while (!waiting.empty()) {
      const auto [index, above] = waiting.back();
      waiting.pop_back();
      if (visited_[static_cast<size_t>(index)]++) fail("has nodes in a circle; export it again");
      const json& node = nodes_[static_cast<size_t>(index)];
      const Eigen::Affine3d here = above * transform(node);
      if (node.contains("mesh")) {
        // The vertices of a skinned mesh are placed by its joints, whatever its node says.
        const bool skinned = node.contains("skin");
        add_mesh(index, document_.index(node, "mesh", meshes_.size()),
                 skinned ? Eigen::Affine3d::Identity() : here);
      }
      std::vector<int64_t> children = document_.indices(node, "children", nodes_.size());
      std::reverse(children.begin(), children.end());
      for (const int64_t child : children) waiting.emplace_back(child, here);
    }
  }

  Eigen::Affine3d transform(const json& node) const {
    Eigen::Affine3d result = Eigen::Affine3d::Identity();
    if (node.contains("matrix")) {
      const std::vector<double> m = document_.numbers(node, "matrix", 16);
      result.matrix() = Eigen::Map<const Eigen::Matrix4d>(m.data());  // Both by columns.
      result.makeAffine();
      return result;
    }
    if (node.contains("translation")) {
      const std::vector<double> t = document_.numbers(node, "translation", 3);
      result.translate(Eigen::Vector3d(t[0], t[1], t[2]));
    }
    if (node.contains("rotation")) {
      const std::vector<double> q = document_.numbers(node, "rotation", 4);
      result.rotate(Eigen::Quaterniond(q[3], q[0], q[1], q[2]).normalized());
    }
    if (node.contains("scale")) {
      const std::vector<double> s = document_.numbers(node, "scale", 3);
      result.scale(Eigen::Vector3d(s[0], s[1], s[2]));
    }
    return result;
  }

  void add_mesh(int64_t node, int64_t index, const Eigen::Affine3d& placement) {
    Rows rows;
    const json& primitives = document_.list(meshes_[static_cast<size_t>(index)], "primitives");
    for (size_t p = 0; p < primitives.size(); ++p) {
      if (!primitives[p].is_object()) continue;
      const GltfPart part{node, index, static_cast<int64_t>(p), 0, 0, placement.linear()};
      add_primitive(primitives[p], placement, rows, part);
    }
  }

  void add_primitive(const json& primitive, const Eigen::Affine3d& placement, Rows& rows,
                     GltfPart part) {
    const int64_t mode = document_.whole(primitive, "mode", kTriangles);
    if (mode < kTriangles) {
      ++mesh_.lines_and_points;
      return;
    }
    if (mode > kTriangleFan) fail("has a primitive of unknown mode; export it again");
    const json& attributes = primitive.value("attributes", json::object());
    if (!attributes.contains("POSITION")) return;  // Allowed, and shows nothing.
    const int64_t positions = document_.whole(attributes, "POSITION");
    const std::vector<int64_t> corners = corners_of(primitive, positions);
    const int first = add_vertices(positions, placement, rows);
    part.positions = positions;
    part.first_vertex = first;
    parts_.push_back(part);
    check_range(corners, positions);
    int texture = -1;
    if (attributes.contains("TEXCOORD_0")) {
      const int64_t texcoords = document_.whole(attributes, "TEXCOORD_0");
      texture = add_texcoords(texcoords, rows);
      check_range(corners, texcoords);
    }
    if (attributes.contains("COLOR_0")) add_colours(attributes, positions, first);
    add_triangles(corners, mode, first, texture, placement.linear().determinant() < 0.0);
    const bool plain = !primitive.contains("material");
    const int64_t material =
        plain ? -1 : document_.index(primitive, "material", document_.list("materials").size());
    mesh_.polygon_material.resize(mesh_.polygons.size(), static_cast<int>(material));
  }

  /// Colours of the vertices from `first` on, from glTF's linear ones.
  void add_colours(const json& attributes, int64_t positions, int first) {
    const int64_t accessor = document_.whole(attributes, "COLOR_0");
    const int64_t count = document_.accessor_count(positions);
    const int64_t width = document_.accessor_width(accessor);
    if (document_.accessor_count(accessor) != count || width < 3) return;
    const std::vector<double> values = document_.accessor_numbers(accessor, width);
    mesh_.colours.resize(static_cast<size_t>(first + count), Eigen::Vector4d::Ones());
    for (int64_t v = 0; v < count; ++v) {
      for (int64_t k = 0; k < std::min<int64_t>(width, 4); ++k) {
        const double linear = std::clamp(values[static_cast<size_t>(width * v + k)], 0.0, 1.0);
        const double screen =
            linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1 / 2.4) - 0.055;
        mesh_.colours[static_cast<size_t>(first + v)][k] = k < 3 ? screen : linear;
      }
    }
  }

  std::vector<int64_t> corners_of(const json& primitive, int64_t positions) const {
    std::vector<int64_t> corners;
    if (primitive.contains("indices")) {
      corners = document_.accessor_indices(document_.whole(primitive, "indices"));
    } else {
      corners.resize(static_cast<size_t>(document_.accessor_count(positions)));
      std::iota(corners.begin(), corners.end(), int64_t{0});
    }
    check_size(corners.size());
    return corners;
  }

  void check_range(const std::vector<int64_t>& corners, int64_t accessor) const {
    const int64_t count = document_.accessor_count(accessor);
    for (const int64_t corner : corners) {
      if (corner >= count) fail("has a face with a vertex index out of range; export it again");
    }
  }

  /// @return the row of the first.
  int add_vertices(int64_t accessor, const Eigen::Affine3d& placement, Rows& rows) {
    const auto [known, added] =
        rows.vertices.try_emplace(accessor, static_cast<int>(mesh_.vertices.size()));
    if (!added) return known->second;
    const std::vector<double> values = document_.accessor_numbers(accessor, 3);
    check_size(values.size() / 3);
    for (size_t i = 0; i + 2 < values.size(); i += 3) {
      mesh_.vertices.emplace_back(placement *
                                  Eigen::Vector3d(values[i], values[i + 1], values[i + 2]));
    }
    return known->second;
  }

  /// @return the row of the first; glTF counts v from the top of the picture, everybody else from
  /// below.
  int add_texcoords(int64_t accessor, Rows& rows) {
    const auto [known, added] =
        rows.texcoords.try_emplace(accessor, static_cast<int>(mesh_.texcoords.size()));
    if (!added) return known->second;
    const std::vector<double> values = document_.accessor_numbers(accessor, 2);
    check_size(values.size() / 2);
    for (size_t i = 0; i + 1 < values.size(); i += 2) {
      mesh_.texcoords.emplace_back(values[i], 1.0 - values[i + 1]);
    }
    return known->second;
  }

  void add_triangles(const std::vector<int64_t>& corners, int64_t mode, int first, int texture,
                     bool mirrored) {
    const size_t step = mode == kTriangles ? 3 : 1;
    for (size_t i = 0; i + 2 < corners.size(); i += step) {
      int64_t a = corners[mode == kTriangleFan ? 0 : i];
      int64_t b = corners[i + 1];
      const int64_t c = corners[i + 2];
      // Every second triangle of a strip turns the other way, and so does a mirrored mesh.
      const bool odd = mode == kTriangleStrip && i % 2 == 1;
      if (odd != mirrored) std::swap(a, b);
      const auto row = [&](int base) {
        return std::vector<int>{base + static_cast<int>(a), base + static_cast<int>(b),
                                base + static_cast<int>(c)};
      };
      mesh_.polygons.push_back(row(first));
      mesh_.polygon_texcoords.push_back(texture < 0 ? std::vector<int>() : row(texture));
    }
  }

  /// A few nodes can show a large mesh many times: the result stays within four times the file.
  void check_size(size_t more) const {
    const auto total = static_cast<int64_t>(mesh_.vertices.size() + mesh_.texcoords.size() +
                                            3 * mesh_.polygons.size() + more);
    if (total > std::max<int64_t>(1'000'000, 4 * document_.num_bytes())) {
      fail("shows its meshes too many times; export the one that is wanted");
    }
  }

  const GltfDocument& document_;
  const json& nodes_;
  const json& meshes_;
  std::vector<char> visited_;
  RawMesh mesh_;
  std::vector<GltfPart> parts_;
};

}  // namespace

RawMesh read_gltf_scene(const GltfDocument& document, std::vector<GltfPart>* parts) {
  GltfScene scene(document);
  RawMesh mesh = scene.read();
  if (parts != nullptr) *parts = scene.parts();
  return mesh;
}

RawMesh read_gltf(const std::filesystem::path& path, const std::string& bytes) {
  try {
    return read_gltf_scene(GltfDocument(path, bytes));
  } catch (const json::exception&) {
    throw std::runtime_error("mesh file " + path.string() +
                             " is damaged or not glTF; export it again");
  }
}

}  // namespace freetalk::mesh
