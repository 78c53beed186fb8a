// Polygon meshes and the files they come from: OBJ, PLY, OFF, STL, glTF in; OBJ, PLY out.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace freetalk::mesh {

/// A mesh as its file has it, plus a triangulation of its polygons.
struct Mesh {
  Eigen::MatrixXd vertices;  ///< (V, 3), the file's unit and order; unreferenced vertices are kept.
  Eigen::MatrixXi faces;     ///< (F, 3) triangles.
  /// Vertex indices of each polygon as in the file; empty if every polygon is a triangle (then
  /// `faces`).
  std::vector<std::vector<int>> polygons;
  Eigen::MatrixXd texcoords;  ///< (Vt, 2); empty without texture coordinates.
  /// Rows of `texcoords` of each polygon's corners (of each triangle's if `polygons` is empty); an
  /// empty list for a polygon without. Empty if the mesh has no texture coordinates.
  std::vector<std::vector<int>> polygon_texcoords;
  std::vector<int> face_polygon;  ///< (F,) the polygon each triangle was cut from.
  int64_t lines_and_points = 0;   ///< Elements of fewer than three corners, which are not kept.
  std::string name;               ///< The file's name without folder and extension, for messages.
  std::filesystem::path source;   ///< The file it was read from; empty for a mesh made in memory.

  int64_t num_vertices() const { return vertices.rows(); }
  int64_t num_faces() const { return faces.rows(); }
  /// The number of polygons as in the file.
  int64_t num_polygons() const {
    return polygons.empty() ? faces.rows() : static_cast<int64_t>(polygons.size());
  }
  /// Vertex indices of polygon `index` as in the file.
  std::vector<int> polygon(int64_t index) const;
};

/// A triangulation of polygons.
struct Triangulation {
  Eigen::MatrixXi faces;          ///< (F, 3)
  std::vector<int> face_polygon;  ///< (F,)
};

/// Cuts polygons into triangles: quads along the diagonal that folds least (inside the polygon if
/// it is not convex), larger ones by ear clipping in their mean plane. Polygons of fewer than three
/// corners give none.
Triangulation triangulate(const Eigen::MatrixXd& vertices,
                          const std::vector<std::vector<int>>& polygons);

/// A mesh of polygons given in memory (texture coordinates optional), with the door's checks.
/// @throws std::invalid_argument naming `name` for no vertices, no faces, indices out of range,
/// NaN.
Mesh make_mesh(Eigen::MatrixXd vertices, std::vector<std::vector<int>> polygons,
               Eigen::MatrixXd texcoords, std::vector<std::vector<int>> polygon_texcoords,
               std::string name);

/// Reads an OBJ, PLY, OFF, STL, .gltf or .glb file. No face is dropped: non-manifold, duplicate and
/// degenerate ones stay. Of glTF, the triangles of all meshes its scene shows, moved by their
/// nodes, at rest (no skin, no morph).
/// @throws std::runtime_error, one sentence naming the file and what to do: missing, empty, not a
/// mesh,
///   no faces, indices out of range, vertices that are not finite.
Mesh load_mesh(const std::filesystem::path& path);

/// Writes an OBJ or PLY (by extension) atomically: polygons, texture coordinates and vertex order
/// are kept. PLY holds texture coordinates per face corner, as MeshLab does.
/// @throws std::runtime_error naming the file if it cannot be written.
void save_mesh(const std::filesystem::path& path, const Mesh& mesh);

}  // namespace freetalk::mesh
