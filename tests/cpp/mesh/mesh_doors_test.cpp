#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include <bit>
#include <cstring>

#include "freetalk/mesh/components.h"
#include "freetalk/mesh/mesh.h"
#include "freetalk/mesh/normals.h"
#include "freetalk/mesh/report.h"
#include "shapes.h"

namespace freetalk::mesh {
namespace {

using nlohmann::json;
using testing::message_of;
using testing::TemporaryFolder;

template <class T>
std::string raw(std::initializer_list<T> values) {
  std::string bytes;
  for (const T value : values) bytes.append(reinterpret_cast<const char*>(&value), sizeof(T));
  return bytes;
}

/// 32-bit words, big-endian.
std::string words(std::initializer_list<uint32_t> values) {
  std::string bytes;
  for (const uint32_t value : values) {
    for (int shift = 24; shift >= 0; shift -= 8) bytes.push_back(static_cast<char>(value >> shift));
  }
  return bytes;
}

uint32_t bits(float value) { return std::bit_cast<uint32_t>(value); }

/// A unit square of two triangles: positions, 16-bit indices, texture coordinates.
struct GltfSquare {
  std::string blob = raw<float>({0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0}) +
                     raw<uint16_t>({0, 1, 2, 0, 2, 3}) + raw<float>({0, 0, 1, 0, 1, 1, 0, 1});
  json document = {{"asset", {{"version", "2.0"}}},
                   {"scene", 0},
                   {"scenes", {{{"nodes", {0}}}}},
                   {"nodes", {{{"mesh", 0}}}},
                   {"meshes",
                    {{{"primitives",
                       {{{"attributes", {{"POSITION", 0}, {"TEXCOORD_0", 2}}}, {"indices", 1}}}}}}},
                   {"accessors",
                    {{{"bufferView", 0}, {"componentType", 5126}, {"count", 4}, {"type", "VEC3"}},
                     {{"bufferView", 1}, {"componentType", 5123}, {"count", 6}, {"type", "SCALAR"}},
                     {{"bufferView", 2}, {"componentType", 5126}, {"count", 4}, {"type", "VEC2"}}}},
                   {"bufferViews",
                    {{{"buffer", 0}, {"byteOffset", 0}, {"byteLength", 48}},
                     {{"buffer", 0}, {"byteOffset", 48}, {"byteLength", 12}},
                     {{"buffer", 0}, {"byteOffset", 60}, {"byteLength", 32}}}},
                   {"buffers", {{{"byteLength", 92}}}}};

  std::string glb() const {
    std::string text = document.dump();
    text.resize((text.size() + 3) / 4 * 4, ' ');
    const auto size = static_cast<uint32_t>(28 + text.size() + blob.size());
    return "glTF" + raw<uint32_t>({2, size, static_cast<uint32_t>(text.size())}) + "JSON" + text +
           raw<uint32_t>({static_cast<uint32_t>(blob.size())}) + std::string("BIN\0", 4) + blob;
  }
};

TEST(Gltf, ReadsTrianglesAndTextureCoordinatesOfGlb) {
  const TemporaryFolder folder;
  const Mesh mesh = load_mesh(folder.write("square.glb", GltfSquare().glb()));
  EXPECT_EQ(mesh.num_vertices(), 4);
  ASSERT_EQ(mesh.num_faces(), 2);
  EXPECT_EQ(mesh.polygon(1), (std::vector<int>{0, 2, 3}));
  EXPECT_EQ(mesh.texcoords(2, 0), 1.0);
  EXPECT_EQ(mesh.texcoords(2, 1), 0.0);  // glTF counts from the top.
  EXPECT_EQ(mesh.polygon_texcoords[1], (std::vector<int>{0, 2, 3}));
}

TEST(Gltf, ReadsTextWithDataInsideAndBeside) {
  const TemporaryFolder folder;
  GltfSquare square;
  folder.write("a b.bin", square.blob);
  square.document["buffers"][0]["uri"] = "a%20b.bin";
  EXPECT_EQ(load_mesh(folder.write("beside.gltf", square.document.dump())).num_faces(), 2);
  // 36 bytes of three points, no indices.
  square.document["buffers"][0]["uri"] =
      "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA";
  square.document["accessors"][0]["count"] = 3;
  square.document["bufferViews"][0]["byteLength"] = 36;
  square.document["meshes"][0]["primitives"][0] = {{"attributes", {{"POSITION", 0}}}};
  const Mesh mesh = load_mesh(folder.write("inside.gltf", square.document.dump()));
  EXPECT_EQ(mesh.num_faces(), 1);
  EXPECT_EQ(mesh.vertices(1, 0), 1.0);
  EXPECT_EQ(mesh.vertices(2, 1), 1.0);
  EXPECT_EQ(mesh.texcoords.rows(), 0);
}

TEST(Gltf, PlacesMeshesByTheirNodes) {
  const TemporaryFolder folder;
  GltfSquare square;
  const double half = std::sqrt(0.5);
  square.document["scenes"][0]["nodes"] = {0, 2};
  square.document["nodes"] = {
      {{"translation", {10, 0, 0}}, {"children", {1}}},
      // A quarter turn about z after a stretch.
      {{"mesh", 0}, {"rotation", {0, 0, half, half}}, {"scale", {2, 1, 1}}},
      {{"mesh", 0}, {"matrix", {-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 7, 1}}}};
  const Mesh mesh = load_mesh(folder.write("nodes.glb", square.glb()));
  ASSERT_EQ(mesh.num_vertices(), 8);
  EXPECT_TRUE(mesh.vertices.row(1).isApprox(Eigen::RowVector3d(10, 2, 0), 1e-12));
  EXPECT_TRUE(mesh.vertices.row(5).isApprox(Eigen::RowVector3d(-1, 0, 7), 1e-12));
  // The mirrored copy is turned round, so that its faces look the way they did.
  const Eigen::MatrixXd normals = face_normals(mesh.vertices, mesh.faces);
  for (Eigen::Index f = 0; f < 4; ++f) EXPECT_NEAR(normals(f, 2), 1.0, 1e-12);
}

TEST(Gltf, SharesVerticesBetweenPrimitivesOfAMesh) {
  const TemporaryFolder folder;
  GltfSquare square;
  json& primitives = square.document["meshes"][0]["primitives"];
  primitives.push_back(primitives[0]);
  primitives.push_back({{"attributes", {{"POSITION", 0}}}, {"mode", 1}});
  const Mesh mesh = load_mesh(folder.write("shared.glb", square.glb()));
  EXPECT_EQ(mesh.num_vertices(), 4);
  EXPECT_EQ(mesh.num_faces(), 4);
  EXPECT_EQ(mesh.lines_and_points, 1);
}

TEST(Gltf, UnrollsStripsAndFansAndNormalizedNumbers) {
  const TemporaryFolder folder;
  GltfSquare square;
  square.document["meshes"][0]["primitives"] = {{{"attributes", {{"POSITION", 0}}}, {"mode", 5}},
                                                {{"attributes", {{"POSITION", 0}}}, {"mode", 6}}};
  const Mesh mesh = load_mesh(folder.write("strip.glb", square.glb()));
  ASSERT_EQ(mesh.num_faces(), 4);
  EXPECT_EQ(mesh.polygon(1), (std::vector<int>{2, 1, 3}));
  EXPECT_EQ(mesh.polygon(3), (std::vector<int>{0, 2, 3}));
  square.blob = raw<int16_t>({0, 0, 0, 32767, 0, 0, -32768, -32767, 0, 0, 0, 0});
  square.document["accessors"][0]["componentType"] = 5122;
  square.document["accessors"][0]["normalized"] = true;
  square.document["bufferViews"][0]["byteLength"] = 24;
  const Mesh small = load_mesh(folder.write("small.glb", square.glb()));
  EXPECT_EQ(small.vertices(1, 0), 1.0);
  EXPECT_EQ(small.vertices(2, 0), -1.0);
}

TEST(Gltf, NamesFileAndRemedyForBadInput) {
  const TemporaryFolder folder;
  const auto problem = [&](const std::string& bytes, const char* part) {
    const auto file = folder.write("bad.glb", bytes);
    const std::string message = message_of([&] { load_mesh(file); });
    EXPECT_NE(message.find(file.string()), std::string::npos) << message;
    EXPECT_NE(message.find(part), std::string::npos) << message;
  };
  const auto changed = [&](const std::string& pointer, const json& value, const char* part) {
    GltfSquare square;
    square.document[json::json_pointer(pointer)] = value;
    problem(square.glb(), part);
  };
  const std::string primitive = "/meshes/0/primitives/0";
  changed(primitive + "/extensions/KHR_draco_mesh_compression", json::object(), "damaged");
  changed("/bufferViews/0/extensions/EXT_meshopt_compression", json::object(), "damaged");
  changed("/asset/version", "1.0", "version 2");
  changed("/accessors/0/count", 5, "cut short");
  changed("/accessors/0/count", 4000000000u, "cut short");
  changed("/accessors/0/count", -1, "damaged");
  changed("/accessors/0/type", 3, "damaged");
  changed("/accessors/1/componentType", 5126, "damaged");
  changed("/bufferViews/2/byteLength", 1e300, "damaged");
  changed("/nodes/0/mesh", 3, "damaged");
  changed("/nodes/0/children", {0}, "circle");
  changed("/nodes/0/rotation", {0, 0, 1}, "damaged");
  changed("/meshes", json::array(), "damaged");
  changed("/nodes", json::array({json::object()}), "no vertices");
  changed("/buffers/0/uri", "../secret.bin", "outside its folder");
  changed("/buffers/0/uri", "absent.bin", "is not there");
  changed("/buffers/0/uri", "https://example.org/a.bin", "outside its folder");
  GltfSquare square;
  square.blob.replace(48, 2, raw<uint16_t>({9}));
  problem(square.glb(), "index out of range");
  problem(GltfSquare().glb().substr(0, 100), "cut short");
  problem("{\"asset\": ", "not glTF");
  problem("glTF\1", "cut short");
  // A thousand copies of a large mesh in a small file.
  square = GltfSquare();
  square.blob.resize(120000, '\0');
  square.document["bufferViews"][0]["byteLength"] = 120000;
  square.document["accessors"][0]["count"] = 10000;
  square.document["nodes"] = json::array();
  for (int n = 0; n < 1000; ++n) {
    square.document["nodes"].push_back({{"mesh", 0}});
    square.document["scenes"][0]["nodes"].push_back(n);
  }
  square.document["scenes"][0]["nodes"].erase(0);
  problem(square.glb(), "too many times");
}

TEST(BinaryOff, ReadsVerticesAndFacesBehindNormalsAndColours) {
  const TemporaryFolder folder;
  const uint32_t one = bits(1.0f), zero = 0;
  const std::string bytes = "NOFF BINARY\n" + words({3, 1, 0}) +
                            words({zero, zero, zero, 9, 9, 9, one, zero, zero, 9, 9, 9, zero,
                                   bits(2.0f), zero, 9, 9, 9}) +
                            words({3, 0, 1, 2, 1, one});
  const Mesh mesh = load_mesh(folder.write("a.off", bytes));
  ASSERT_EQ(mesh.num_faces(), 1);
  EXPECT_EQ(mesh.vertices(2, 1), 2.0);
  EXPECT_EQ(mesh.polygon(0), (std::vector<int>{0, 1, 2}));
  const std::string cut = bytes.substr(0, bytes.size() - 6);
  EXPECT_NE(message_of([&] { load_mesh(folder.write("b.off", cut)); }).find("cut short"),
            std::string::npos);
  EXPECT_NE(message_of([&] { load_mesh(folder.write("c.off", "OFF BINARY")); }).find("cut short"),
            std::string::npos);
  EXPECT_NE(message_of([&] {
              load_mesh(folder.write("d.off", "4OFF\n1 1 0\n"));
            }).find("three dimensions"),
            std::string::npos);
}

Mesh mesh_of(const testing::Shape& shape, std::vector<std::vector<int>> more = {}) {
  std::vector<std::vector<int>> polygons;
  for (Eigen::Index f = 0; f < shape.faces.rows(); ++f) {
    polygons.push_back({shape.faces(f, 0), shape.faces(f, 1), shape.faces(f, 2)});
  }
  polygons.insert(polygons.end(), more.begin(), more.end());
  return make_mesh(shape.vertices, polygons, {}, {}, "m");
}

TEST(MeshReport, FindsNothingOnACleanClosedMesh) {
  const MeshReport report = mesh_report(mesh_of(testing::sphere(2)));
  EXPECT_EQ(report.parts, 1);
  EXPECT_EQ(report.edges, report.triangles * 3 / 2);
  EXPECT_EQ(report.boundaries, 0);
  EXPECT_TRUE(report.extent.isApprox(Eigen::Vector3d(2, 2, 2)));
  EXPECT_TRUE(report.findings().empty());
}

TEST(MeshReport, CountsRimsAndParts) {
  testing::Shape shape = testing::join(testing::grid(5), testing::grid(3));
  const MeshReport two = mesh_report(mesh_of(shape));
  EXPECT_EQ(two.parts, 2);
  EXPECT_EQ(two.boundaries, 2);
  EXPECT_EQ(two.boundary_edges, 16 + 8);
  // Two triangles out of the middle of the first: a rim more.
  shape.faces.middleRows(10, shape.faces.rows() - 12) =
      shape.faces.bottomRows(shape.faces.rows() - 12).eval();
  shape.faces.conservativeResize(shape.faces.rows() - 2, 3);
  EXPECT_EQ(mesh_report(mesh_of(shape)).boundaries, 3);
}

TEST(MeshReport, CountsEachDefectOnce) {
  const testing::Shape grid = testing::grid(4);  // Faces 0: (0, 1, 5), 1: (0, 5, 4), ...
  const auto with = [&](std::vector<std::vector<int>> more) {
    return mesh_report(mesh_of(grid, std::move(more)));
  };
  EXPECT_EQ(with({{0, 5, 10}}).nonmanifold_edges, 2);  // Edges 0-5 and 5-10 are diagonals.
  EXPECT_EQ(with({{5, 1, 0}}).duplicate_polygons, 1);
  EXPECT_EQ(with({{7, 7, 3}}).repeated_corner_polygons, 1);
  EXPECT_EQ(with({{7, 7, 3}}).zero_area_triangles, 1);
  EXPECT_EQ(with({{0, 1, 2}}).zero_area_triangles, 1);
  EXPECT_EQ(with({{2, 3, 7, 6}}).larger_polygons, 1);
  EXPECT_EQ(with({{4, 2}}).lines_and_points, 1);
  EXPECT_EQ(with({}).findings().size(), 0u);
  testing::Shape turned = grid;
  std::swap(turned.faces(0, 0), turned.faces(0, 1));
  EXPECT_EQ(mesh_report(mesh_of(turned)).inconsistent_edges, 2);  // One side is on the rim.
  testing::Shape loose = grid;
  loose.vertices.conservativeResize(18, 3);
  loose.vertices.row(16) = grid.vertices.row(3);
  loose.vertices.row(17) << 50, 50, 50;
  const MeshReport report = mesh_report(mesh_of(loose));
  EXPECT_EQ(report.unreferenced_vertices, 2);
  EXPECT_EQ(report.coincident_vertices, 1);
  EXPECT_EQ(report.parts, 1);
  EXPECT_EQ(report.extent.x(), 1.0);
}

TEST(MeshReport, CountsVerticesWhereSurfacesTouchInAPoint) {
  // Two fans that share vertex 0 alone, and a book of three pages along 0-1: no second fan there.
  Eigen::MatrixXd points = Eigen::MatrixXd::Random(6, 3);
  const auto count = [&](std::vector<std::vector<int>> polygons) {
    return mesh_report(make_mesh(points, std::move(polygons), {}, {}, "m")).nonmanifold_vertices;
  };
  EXPECT_EQ(count({{0, 1, 2}, {0, 3, 4}}), 1);
  EXPECT_EQ(count({{0, 1, 2}, {0, 1, 3}, {0, 1, 4}}), 0);
  EXPECT_EQ(count({{0, 1, 2}, {2, 0, 3}, {3, 0, 4}, {4, 0, 1}}), 0);
  EXPECT_EQ(count({{0, 0, 1}, {0, 1, 2}}), 0);
}

}  // namespace
}  // namespace freetalk::mesh
