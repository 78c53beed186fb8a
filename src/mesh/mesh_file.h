// What the readers and writers of single formats share.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "freetalk/mesh/mesh.h"

namespace freetalk::mesh {

/// A mesh as read, not yet checked: indices may point anywhere.
struct RawMesh {
  std::vector<Eigen::Vector3d> vertices;
  std::vector<std::vector<int>> polygons;
  std::vector<Eigen::Vector2d> texcoords;
  std::vector<std::vector<int>> polygon_texcoords;  // as many as polygons, or none
  int64_t lines_and_points = 0;                     // elements that are no polygons, not kept
  std::vector<Eigen::Vector4d> colours;             // of vertices, in [0, 1]; as many, or none
  std::vector<std::string> materials;               // names, in order of first use
  std::vector<int> polygon_material;                // as many as polygons, -1: none; or none
  std::vector<std::string> material_files;          // OBJ: libraries; PLY: the texture
};

/// Reads a file by its extension. @throws std::runtime_error, one sentence naming the file.
RawMesh read_raw_mesh(const std::filesystem::path& path);

/// Wavefront OBJ text. @throws std::runtime_error naming the file and the line.
RawMesh read_obj(const std::filesystem::path& path, const std::string& text);

/// PLY bytes. @throws std::runtime_error naming the file.
RawMesh read_ply(const std::filesystem::path& path, const std::string& bytes);

/// OFF, text or binary. @throws std::runtime_error naming the file.
RawMesh read_off(const std::filesystem::path& path, const std::string& bytes);

/// glTF 2.0, text or GLB. @throws std::runtime_error naming the file.
RawMesh read_gltf(const std::filesystem::path& path, const std::string& bytes);

/// STL, text or binary, of which `bytes` are the content. @throws std::runtime_error naming the
/// file.
RawMesh read_stl(const std::filesystem::path& path, const std::string& bytes);

/// The file that save_mesh writes. @param extension "obj" or "ply"
std::string mesh_bytes(const Mesh& mesh, const std::string& extension);

}  // namespace freetalk::mesh
