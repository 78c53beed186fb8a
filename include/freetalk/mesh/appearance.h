// How the surface of a mesh file looks: materials, textures and colours of vertices, for writers.
#pragma once

#include <Eigen/Core>

#include <string>
#include <vector>

#include "freetalk/mesh/mesh.h"

namespace freetalk::mesh {

/// A PNG or JPEG as its file has it.
struct Texture {
  std::string name;        ///< file name without folder
  std::string media_type;  ///< "image/png" or "image/jpeg"
  std::string bytes;
};

/// What MTL and glTF's metallic-roughness model have in common.
struct Material {
  std::string name;
  Eigen::Vector4d colour =
      Eigen::Vector4d::Ones();  ///< red, green, blue, opacity in [0, 1]; linear
  Texture texture;              ///< times the colour; empty without
};

struct Appearance {
  std::vector<Material> materials;
  /// (P,) material of each polygon of the mesh, -1 for none; empty if there are no materials.
  std::vector<int> polygon_material;
  Eigen::MatrixXd colours;  ///< (V, 4) of the vertices in [0, 1], sRGB; empty without
};

/// Looks up `mesh.source` again: MTL libraries and vertex colours of an OBJ, vertex colours and
/// texture of a PLY, base colours, their textures and vertex colours of a glTF. Only pictures and
/// libraries in the folder of the file (or below it) are read.
/// @returns nothing where the mesh has no file, the file is gone or of another kind, or it no
/// longer has the polygons and vertices of `mesh`.
Appearance load_appearance(const Mesh& mesh);

/// As save_mesh(path, mesh), with its look: of an OBJ the colours of the vertices and an MTL
/// library with its textures beside it, of a PLY the colours and the first texture. Names of
/// textures begin with that of the mesh file.
/// @throws std::invalid_argument where the appearance is of another number of polygons or vertices.
void save_mesh(const std::filesystem::path& path, const Mesh& mesh, const Appearance& appearance);

}  // namespace freetalk::mesh
