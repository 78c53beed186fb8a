#include "freetalk/mesh/mesh.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <utility>

#include "core/file.h"
#include "freetalk/core/error.h"
#include "mesh/mesh_file.h"

namespace freetalk::mesh {
namespace {

using Reader = RawMesh (*)(const std::filesystem::path&, const std::string&);

template <int Columns>
Eigen::MatrixXd to_matrix(const std::vector<Eigen::Matrix<double, Columns, 1>>& rows) {
  Eigen::MatrixXd matrix(static_cast<Eigen::Index>(rows.size()), Columns);
  for (size_t i = 0; i < rows.size(); ++i) matrix.row(static_cast<Eigen::Index>(i)) = rows[i];
  return matrix;
}

/// One sentence on what is wrong with the numbers of a mesh, empty if nothing is.
std::string find_problem(const Eigen::MatrixXd& vertices,
                         const std::vector<std::vector<int>>& polygons,
                         const Eigen::MatrixXd& texcoords,
                         const std::vector<std::vector<int>>& polygon_texcoords) {
  const Eigen::Index count = vertices.rows();
  if (count == 0) return "has no vertices; choose a mesh with vertices and faces";
  if (count > std::numeric_limits<int>::max()) return "has too many vertices; decimate it";
  for (Eigen::Index v = 0; v < count; ++v) {
    if (!vertices.row(v).allFinite()) {
      return core::join("has vertices that are not finite numbers (the first is vertex ", v,
                        "); repair it in a mesh editor");
    }
  }
  bool any = false;
  for (size_t p = 0; p < polygons.size(); ++p) {
    any |= polygons[p].size() >= 3;
    for (const int v : polygons[p]) {
      if (v < 0 || v >= count) {
        return core::join("has a face (number ", p + 1, ") with a vertex index outside its ", count,
                          " vertices; export it again or repair it in a mesh editor");
      }
    }
  }
  if (!any) return "has no faces; choose a mesh, not a point cloud";
  for (const std::vector<int>& corners : polygon_texcoords) {
    for (const int t : corners) {
      if (t < 0 || t >= texcoords.rows()) {
        return "has a texture coordinate index out of range; export it again";
      }
    }
  }
  return {};
}

/// @return how many there were.
int64_t drop_lines_and_points(std::vector<std::vector<int>>& polygons,
                              std::vector<std::vector<int>>& polygon_texcoords) {
  const size_t before = polygons.size();
  size_t kept = 0;
  for (size_t p = 0; p < polygons.size(); ++p) {
    if (polygons[p].size() < 3) continue;
    if (p != kept) {
      polygons[kept] = std::move(polygons[p]);
      if (!polygon_texcoords.empty()) polygon_texcoords[kept] = std::move(polygon_texcoords[p]);
    }
    ++kept;
  }
  polygons.resize(kept);
  if (!polygon_texcoords.empty()) polygon_texcoords.resize(kept);
  return static_cast<int64_t>(before - kept);
}

Mesh assemble(Eigen::MatrixXd vertices, std::vector<std::vector<int>> polygons,
              Eigen::MatrixXd texcoords, std::vector<std::vector<int>> polygon_texcoords,
              std::string name) {
  Mesh mesh;
  mesh.lines_and_points = drop_lines_and_points(polygons, polygon_texcoords);
  mesh.name = std::move(name);
  mesh.vertices = std::move(vertices);
  mesh.texcoords = std::move(texcoords);
  mesh.polygon_texcoords = std::move(polygon_texcoords);
  Triangulation cut = triangulate(mesh.vertices, polygons);
  mesh.faces = std::move(cut.faces);
  mesh.face_polygon = std::move(cut.face_polygon);
  const bool only_triangles = std::all_of(polygons.begin(), polygons.end(),
                                          [](const auto& polygon) { return polygon.size() == 3; });
  if (!only_triangles) mesh.polygons = std::move(polygons);
  return mesh;
}

}  // namespace

std::vector<int> Mesh::polygon(int64_t index) const {
  if (!polygons.empty()) return polygons.at(static_cast<size_t>(index));
  return {faces(index, 0), faces(index, 1), faces(index, 2)};
}

Mesh make_mesh(Eigen::MatrixXd vertices, std::vector<std::vector<int>> polygons,
               Eigen::MatrixXd texcoords, std::vector<std::vector<int>> polygon_texcoords,
               std::string name) {
  FREETALK_CHECK(vertices.cols() == 3, "mesh ", name, " needs vertices of shape (V, 3), found ",
                 vertices.cols(), " columns");
  FREETALK_CHECK(polygon_texcoords.empty() || polygon_texcoords.size() == polygons.size(), "mesh ",
                 name, " has ", polygons.size(), " polygons but texture corners of ",
                 polygon_texcoords.size(), "; give one list a polygon");
  for (size_t p = 0; p < polygon_texcoords.size(); ++p) {
    FREETALK_CHECK(
        polygon_texcoords[p].empty() || polygon_texcoords[p].size() == polygons[p].size(), "mesh ",
        name, " polygon ", p, " has another number of texture corners than of vertices");
  }
  const std::string problem = find_problem(vertices, polygons, texcoords, polygon_texcoords);
  FREETALK_CHECK(problem.empty(), "mesh ", name, " ", problem);
  return assemble(std::move(vertices), std::move(polygons), std::move(texcoords),
                  std::move(polygon_texcoords), std::move(name));
}

RawMesh read_raw_mesh(const std::filesystem::path& path) {
  const std::string file = path.string();
  std::error_code error;
  FREETALK_RUNTIME_CHECK(std::filesystem::exists(path, error), "mesh file ", file,
                         " does not exist; check the path");
  FREETALK_RUNTIME_CHECK(std::filesystem::is_regular_file(path, error), "mesh file ", file,
                         " is not a file; give the path of an OBJ, PLY, OFF, STL or glTF file");
  const std::string extension = core::lower_extension(path);
  constexpr std::pair<const char*, Reader> kReaders[] = {{"obj", read_obj},   {"ply", read_ply},
                                                         {"off", read_off},   {"stl", read_stl},
                                                         {"gltf", read_gltf}, {"glb", read_gltf}};
  const auto reader = std::find_if(std::begin(kReaders), std::end(kReaders),
                                   [&](const auto& known) { return extension == known.first; });
  FREETALK_RUNTIME_CHECK(reader != std::end(kReaders), "mesh file ", file,
                         " has no known mesh extension; convert it to OBJ, PLY, OFF, STL or glTF");
  const std::string bytes = core::read_text(path);
  FREETALK_RUNTIME_CHECK(!bytes.empty(), "mesh file ", file, " is empty; export the mesh again");
  return reader->second(path, bytes);
}

Mesh load_mesh(const std::filesystem::path& path) {
  const std::string file = path.string();
  RawMesh raw = read_raw_mesh(path);
  Eigen::MatrixXd vertices = to_matrix<3>(raw.vertices);
  Eigen::MatrixXd texcoords = to_matrix<2>(raw.texcoords);
  const std::string problem =
      find_problem(vertices, raw.polygons, texcoords, raw.polygon_texcoords);
  FREETALK_RUNTIME_CHECK(problem.empty(), "mesh file ", file, " ", problem);
  Mesh mesh = assemble(std::move(vertices), std::move(raw.polygons), std::move(texcoords),
                       std::move(raw.polygon_texcoords), path.stem().string());
  mesh.lines_and_points += raw.lines_and_points;
  mesh.source = std::filesystem::absolute(path);
  return mesh;
}

}  // namespace freetalk::mesh
