#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <ostream>

#include "core/file.h"
#include "freetalk/core/error.h"
#include "freetalk/mesh/appearance.h"
#include "freetalk/mesh/mesh.h"
#include "mesh/mesh_file.h"

namespace freetalk::mesh {
namespace {

/// Shortest text that reads back as the same double.
void append_number(std::string& out, double value) {
  char buffer[32];
  const auto result = std::to_chars(buffer, buffer + sizeof(buffer), value);
  out.append(buffer, result.ptr);
}

void append_row(std::string& out, const char* keyword, const Eigen::MatrixXd& rows,
                Eigen::Index i) {
  out += keyword;
  for (Eigen::Index c = 0; c < rows.cols(); ++c) {
    out.push_back(' ');
    append_number(out, rows(i, c));
  }
  out.push_back('\n');
}

const std::vector<int>* texture_corners(const Mesh& mesh, int64_t polygon) {
  if (mesh.polygon_texcoords.empty()) return nullptr;
  const std::vector<int>& corners = mesh.polygon_texcoords.at(static_cast<size_t>(polygon));
  return corners.empty() ? nullptr : &corners;
}

/// Name of a texture's file beside the mesh `stem`.
std::string texture_file(const std::string& stem, const Texture& texture) {
  return texture.name.starts_with(stem) ? texture.name : stem + "_" + texture.name;
}

/// What polygons without a material have in an OBJ whose other polygons have some.
const std::string kPlain = "plain";

std::string to_mtl(const std::string& stem, const std::vector<Material>& materials) {
  std::string out;
  for (const Material& material : materials) {
    out += "newmtl " + material.name + "\n";
    append_row(out, "Kd", material.colour.head<3>().transpose(), 0);
    append_row(out, "d", material.colour.tail<1>(), 0);
    if (!material.texture.bytes.empty()) {
      out += "map_Kd " + texture_file(stem, material.texture) + "\n";
    }
  }
  return out;
}

std::string to_obj(const Mesh& mesh, const Appearance& look = {}, const std::string& stem = "") {
  std::string out;
  out.reserve(static_cast<size_t>(mesh.num_vertices() * 48 + mesh.num_polygons() * 32));
  if (!look.materials.empty()) out += "mtllib " + stem + ".mtl\n";
  Eigen::MatrixXd vertices = mesh.vertices;
  if (look.colours.rows() > 0) {
    vertices.conservativeResize(Eigen::NoChange, 6);
    vertices.rightCols<3>() = look.colours.leftCols<3>();
  }
  for (Eigen::Index i = 0; i < vertices.rows(); ++i) append_row(out, "v", vertices, i);
  for (Eigen::Index i = 0; i < mesh.texcoords.rows(); ++i) append_row(out, "vt", mesh.texcoords, i);
  int used = -1;
  for (int64_t p = 0; p < mesh.num_polygons(); ++p) {
    const int material =
        look.materials.empty() ? -1 : look.polygon_material[static_cast<size_t>(p)];
    if (material != used) {
      out += "usemtl " +
             (material < 0 ? kPlain : look.materials[static_cast<size_t>(material)].name) + "\n";
      used = material;
    }
    const std::vector<int> polygon = mesh.polygon(p);
    const std::vector<int>* texcoords = texture_corners(mesh, p);
    out.push_back('f');
    for (size_t c = 0; c < polygon.size(); ++c) {
      out.push_back(' ');
      out += std::to_string(polygon[c] + 1);
      if (texcoords == nullptr) continue;
      out.push_back('/');
      out += std::to_string((*texcoords)[c] + 1);
    }
    out.push_back('\n');
  }
  return out;
}

/// Whether each vertex has one texture coordinate, row by row.
bool texcoords_per_vertex(const Mesh& mesh) {
  if (mesh.texcoords.rows() != mesh.vertices.rows()) return false;
  for (int64_t p = 0; p < mesh.num_polygons(); ++p) {
    const std::vector<int>* corners = texture_corners(mesh, p);
    if (corners == nullptr || *corners != mesh.polygon(p)) return false;
  }
  return mesh.num_polygons() > 0;
}

template <class T>
void append_bytes(std::string& out, T value) {
  char bytes[sizeof(T)];
  std::memcpy(bytes, &value, sizeof(T));
  out.append(bytes, sizeof(T));
}

/// Binary little-endian PLY, coordinates as double.
std::string to_ply(const Mesh& mesh, const Appearance& look = {}, const std::string& stem = "") {
  const bool has_texcoords = mesh.texcoords.rows() > 0;
  const bool per_vertex = has_texcoords && texcoords_per_vertex(mesh);
  const bool per_corner = has_texcoords && !per_vertex;
  const Texture* texture = look.materials.empty() ? nullptr : &look.materials.front().texture;
  std::string out = "ply\nformat binary_little_endian 1.0\n";
  if (texture != nullptr && !texture->bytes.empty()) {
    out += "comment TextureFile " + texture_file(stem, *texture) + "\n";
  }
  out += "element vertex " + std::to_string(mesh.num_vertices()) +
         "\nproperty double x\nproperty double y\nproperty double z\n";
  if (look.colours.rows() > 0) {
    out += "property uchar red\nproperty uchar green\nproperty uchar blue\n";
  }
  if (per_vertex) out += "property double s\nproperty double t\n";
  out += "element face " + std::to_string(mesh.num_polygons()) +
         "\nproperty list int int vertex_indices\n";
  if (per_corner) out += "property list uchar float texcoord\n";
  out += "end_header\n";
  for (Eigen::Index i = 0; i < mesh.vertices.rows(); ++i) {
    for (int c = 0; c < 3; ++c) append_bytes(out, mesh.vertices(i, c));
    for (int c = 0; c < 3 && look.colours.rows() > 0; ++c) {
      append_bytes(out, static_cast<uint8_t>(std::lround(255 * look.colours(i, c))));
    }
    for (int c = 0; per_vertex && c < 2; ++c) append_bytes(out, mesh.texcoords(i, c));
  }
  for (int64_t p = 0; p < mesh.num_polygons(); ++p) {
    const std::vector<int> polygon = mesh.polygon(p);
    append_bytes(out, static_cast<int32_t>(polygon.size()));
    for (const int v : polygon) append_bytes(out, static_cast<int32_t>(v));
    if (!per_corner) continue;
    const std::vector<int>* corners = texture_corners(mesh, p);
    const bool fits = corners != nullptr && corners->size() <= 127;  // The count is one byte.
    append_bytes(out, static_cast<uint8_t>(fits ? corners->size() * 2 : 0));
    for (size_t c = 0; fits && c < corners->size(); ++c) {
      append_bytes(out, static_cast<float>(mesh.texcoords((*corners)[c], 0)));
      append_bytes(out, static_cast<float>(mesh.texcoords((*corners)[c], 1)));
    }
  }
  return out;
}

}  // namespace

std::string mesh_bytes(const Mesh& mesh, const std::string& extension) {
  return extension == "obj" ? to_obj(mesh) : to_ply(mesh);
}

namespace {

std::string checked_extension(const std::filesystem::path& path) {
  std::string extension = core::lower_extension(path);
  FREETALK_RUNTIME_CHECK(extension == "obj" || extension == "ply", "mesh file ", path.string(),
                         " cannot be written as '.", extension, "'; use .obj or .ply");
  return extension;
}

}  // namespace

void save_mesh(const std::filesystem::path& path, const Mesh& mesh) {
  const std::string extension = checked_extension(path);
  core::write_file_atomic(path, mesh_bytes(mesh, extension));
}

void save_mesh(const std::filesystem::path& path, const Mesh& mesh, const Appearance& appearance) {
  const std::string extension = checked_extension(path), stem = path.stem().string();
  const auto& [materials, polygon_material, colours] = appearance;
  FREETALK_CHECK(
      (materials.empty() || static_cast<int64_t>(polygon_material.size()) == mesh.num_polygons()) &&
          (colours.rows() == 0 || colours.rows() == mesh.num_vertices()),
      mesh.name, ": the appearance is of ", polygon_material.size(), " polygons and ",
      colours.rows(), " vertices, the mesh has ", mesh.num_polygons(), " and ",
      mesh.num_vertices());
  const bool obj = extension == "obj";
  for (const Material& material : materials) {
    if (material.texture.bytes.empty()) continue;
    core::write_file_atomic(path.parent_path() / texture_file(stem, material.texture),
                            material.texture.bytes);
  }
  if (obj && !materials.empty()) {
    std::vector<Material> all = materials;
    if (std::ranges::count(polygon_material, -1) > 0) all.emplace_back().name = kPlain;
    core::write_file_atomic(path.parent_path() / (stem + ".mtl"), to_mtl(stem, all));
  }
  core::write_file_atomic(path,
                          obj ? to_obj(mesh, appearance, stem) : to_ply(mesh, appearance, stem));
}

}  // namespace freetalk::mesh
