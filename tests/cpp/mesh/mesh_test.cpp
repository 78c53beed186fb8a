#include "freetalk/mesh/mesh.h"

#include <gtest/gtest.h>

#include <cstring>

#include "../decimal_comma.h"
#include "core/file.h"
#include "freetalk/mesh/normals.h"
#include "shapes.h"

namespace freetalk::mesh {
namespace {

using testing::message_of;
using testing::TemporaryFolder;

constexpr const char* kQuadObj =
    "mtllib none.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 9 9 9\n"
    "vt 0 0\nvt 1 0\nvt 1 1\nvt 0.125 1\nvn 0 0 1\nf 1/2/1 2/3/1 3/4/1 4/1/1\n";

template <class T>
std::string raw_bytes(std::initializer_list<T> values) {
  std::string bytes;
  for (const T value : values) bytes.append(reinterpret_cast<const char*>(&value), sizeof(T));
  return bytes;
}

TEST(LoadMesh, KeepsPolygonsTextureCornersAndUnreferencedVerticesOfObj) {
  const TemporaryFolder folder;
  const Mesh mesh = load_mesh(folder.write("Quad.OBJ", kQuadObj));
  EXPECT_EQ(mesh.name, "Quad");
  EXPECT_EQ(mesh.num_vertices(), 5);
  EXPECT_EQ(mesh.num_faces(), 2);
  ASSERT_EQ(mesh.polygons.size(), 1u);
  EXPECT_EQ(mesh.polygons[0], (std::vector<int>{0, 1, 2, 3}));
  EXPECT_EQ(mesh.polygon_texcoords[0], (std::vector<int>{1, 2, 3, 0}));
  EXPECT_EQ(mesh.texcoords(3, 0), 0.125);
  EXPECT_EQ(mesh.face_polygon, (std::vector<int>{0, 0}));
}

TEST(LoadMesh, ReadsRelativeIndicesContinuedLinesAndDoubles) {
  const TemporaryFolder folder;
  const Mesh mesh = load_mesh(folder.write(
      "a.obj", "v 0 0 0 # corner\r\nv +1.00000000001 0 0\r\nv 0 1 0\r\nf -3 \\\r\n -2 -1\r\n"));
  EXPECT_EQ(mesh.polygon(0), (std::vector<int>{0, 1, 2}));
  EXPECT_EQ(mesh.vertices(1, 0), 1.00000000001);
  EXPECT_TRUE(mesh.polygons.empty());
}

TEST(LoadMesh, LosesNoFaceOfNonManifoldAndDegenerateMeshes) {
  const TemporaryFolder folder;
  // Three faces on one edge, one of them twice, one without area, one turned around.
  const std::string faces = "3 0 1 2\n3 0 1 3\n3 0 1 4\n3 0 1 4\n3 0 0 1\n3 2 1 0\n";
  const std::string points = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n0 -1 0\n";
  EXPECT_EQ(load_mesh(folder.write("a.off", "OFF\n5 6 0\n" + points + faces)).num_faces(), 6);
  const std::string header =
      "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float "
      "z\n"
      "element face 6\nproperty list uchar int vertex_indices\nend_header\n";
  EXPECT_EQ(load_mesh(folder.write("a.ply", header + points + faces)).num_faces(), 6);
  const std::string obj =
      "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 0 -1 0\n"
      "f 1 2 3\nf 1 2 4\nf 1 2 5\nf 1 2 5\nf 1 1 2\nf 3 2 1\n";
  EXPECT_EQ(load_mesh(folder.write("a.obj", obj)).num_faces(), 6);
}

TEST(LoadMesh, ReadsTextAndBinaryStl) {
  const TemporaryFolder folder;
  const std::string text =
      "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 "
      "0\nendloop\nendfacet\n"
      "facet normal 0 0 1\nouter loop\nvertex 1 0 0\nvertex 1 1 0\nvertex 0 1 "
      "0\nendloop\nendfacet\n"
      "endsolid s\n";
  const Mesh from_text = load_mesh(folder.write("a.stl", text));
  EXPECT_EQ(from_text.num_faces(), 2);
  EXPECT_EQ(from_text.num_vertices(), 4);
  std::string binary(80, ' ');
  binary += raw_bytes<uint32_t>({1}) + raw_bytes<float>({0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 2, 0}) +
            std::string(2, '\0');
  const Mesh from_binary = load_mesh(folder.write("b.STL", binary));
  EXPECT_EQ(from_binary.num_faces(), 1);
  EXPECT_DOUBLE_EQ(face_areas(from_binary.vertices, from_binary.faces)[0], 2.0);
}

TEST(LoadMesh, ReadsOffWithPrefixesCommentsAndColours) {
  const TemporaryFolder folder;
  const Mesh mesh = load_mesh(folder.write("a.off",
                                           "COFF # coloured\n\n# counts\n3 1 0\n0 0 0 255 0 0 255\n"
                                           "1 0 0 0 0 0 255\n0 +1.5 0 0 0 0 255\n3 0 1 2 9 9 9\n"));
  EXPECT_EQ(mesh.num_faces(), 1);
  EXPECT_EQ(mesh.vertices(2, 1), 1.5);
}

TEST(LoadMesh, ReadsVertexTextureCoordinatesOfPly) {
  const TemporaryFolder folder;
  const Mesh mesh = load_mesh(folder.write(
      "a.ply",
      "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float "
      "z\n"
      "property float u\nproperty float v\nelement face 1\nproperty list uchar int vertex_indices\n"
      "end_header\n0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 0.5\n0 1 0 0 0.5\n4 0 1 2 3\n"));
  ASSERT_EQ(mesh.texcoords.rows(), 4);
  EXPECT_EQ(mesh.texcoords(2, 1), 0.5);
  EXPECT_EQ(mesh.polygon_texcoords[0], (std::vector<int>{0, 1, 2, 3}));
}

TEST(LoadMesh, NamesFileAndRemedyForBadInput) {
  const TemporaryFolder folder;
  const auto problem = [&](const std::string& name, const std::string& bytes) {
    const std::filesystem::path file = folder.write(name, bytes);
    const std::string message = message_of([&] { load_mesh(file); });
    EXPECT_NE(message.find(file.string()), std::string::npos) << name << ": " << message;
    return message;
  };
  const auto has = [](const std::string& message, const std::string& part) {
    EXPECT_NE(message.find(part), std::string::npos) << message;
  };
  has(message_of([&] { load_mesh(folder.path() / "none.obj"); }), "does not exist");
  has(message_of([&] { load_mesh(folder.path()); }), "is not a file");
  has(problem("a.txt", "v 0 0 0"), "no known mesh extension");
  has(problem("empty.obj", ""), "is empty");
  has(problem("words.obj", "these are not the meshes you are looking for\n"), "no vertices");
  has(problem("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n"), "no faces");
  has(problem("range.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n"), "index outside");
  has(problem("zero.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n"), "index outside");
  has(problem("nan.obj", "v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n"), "not finite");
  has(problem("inf.obj", "v 0 0 0\nv 1e999 0 0\nv 0 1 0\nf 1 2 3\n"), "not finite");
  has(problem("text.obj", "v 0 0 zero\n"), "line 1");
  has(problem("range.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n"), "index outside");
  has(problem("nan.off", "OFF\n3 1 0\n0 0 0\nnan 0 0\n0 1 0\n3 0 1 2\n"), "not finite");
  has(problem("short.off", "OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"), "cut short");
  has(problem("huge.off", "OFF\n999999999 1 0\n0 0 0\n"), "more elements");
  has(problem("wide.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n499599999 0 1 2\n"), "impossible size");
  has(problem("binary.off", std::string("OFF BINARY\n\0\0", 13)), "cut short");
  has(problem("not.off", "hello\n"), "is not an OFF");
  has(problem("not.ply", "hello\n"), "is not a PLY");
  has(problem("not.stl", "hello\n"), "is not an STL");
  const std::string ply =
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float "
      "z\n";
  const std::string list = "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
  has(problem("points.ply", ply + "end_header\n0 0 0\n1 0 0\n0 1 0\n"), "no faces");
  has(problem("nan.ply", ply + list + "0 0 0\nNaN 0 0\n0 1 0\n3 0 1 2\n"), "not finite");
  has(problem("range.ply", ply + list + "0 0 0\n1 0 0\n0 1 0\n3 0 1 -2\n"), "index outside");
  has(problem("short.ply", ply + list + "0 0 0\n1 0 0\n"), "cut short");
}

TEST(LoadMesh, NumbersTooSmallForADoubleAreZeroUnderADecimalCommaToo) {
  const freetalk::testing::DecimalComma comma;
  if (!comma.is_set()) GTEST_SKIP() << "no locale with a decimal comma can be had";
  const std::string rows = "1.5e-400 0 0\n1 0 0\n0 1.25 0\n";
  const std::vector<std::pair<std::string, std::string>> files = {
      {"small.obj", "v 1.5e-400 0 0\nv 1 0 0\nv 0 1.25 0\nf 1 2 3\n"},
      {"small.off", "OFF\n3 1 0\n" + rows + "3 0 1 2\n"},
      {"small.ply",
       "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\n"
       "property double z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n" +
           rows + "3 0 1 2\n"}};
  for (const auto& [name, text] : files) {
    const auto path = std::filesystem::path(::testing::TempDir()) / name;
    core::write_file_atomic(path, text);
    const Mesh mesh = load_mesh(path);
    EXPECT_EQ(mesh.vertices(0, 0), 0.0) << name;
    EXPECT_EQ(mesh.vertices(2, 1), 1.25) << name;
  }
}

TEST(LoadMesh, FindsNaNInBinaryPly) {
  const TemporaryFolder folder;
  const std::string header =
      "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
      "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";
  const auto bytes = [&](float x) {
    return header + raw_bytes<float>({0, 0, 0, x, 0, 0, 0, 1, 0}) + raw_bytes<uint8_t>({3}) +
           raw_bytes<int32_t>({0, 1, 2});
  };
  EXPECT_EQ(load_mesh(folder.write("good.ply", bytes(1.0f))).num_faces(), 1);
  const std::string message =
      message_of([&] { load_mesh(folder.write("bad.ply", bytes(std::nanf("")))); });
  EXPECT_NE(message.find("not finite"), std::string::npos) << message;
}

TEST(SaveMesh, ObjKeepsEveryNumberPolygonAndTextureCorner) {
  const TemporaryFolder folder;
  Mesh mesh = load_mesh(folder.write("a.obj", kQuadObj));
  mesh.vertices(0, 0) = 1.0 / 3.0;
  save_mesh(folder.path() / "b.obj", mesh);
  const Mesh again = load_mesh(folder.path() / "b.obj");
  EXPECT_EQ(again.vertices, mesh.vertices);
  EXPECT_EQ(again.polygons, mesh.polygons);
  EXPECT_EQ(again.texcoords, mesh.texcoords);
  EXPECT_EQ(again.polygon_texcoords, mesh.polygon_texcoords);
}

TEST(SaveMesh, PlyKeepsPolygonsAndTextureCoordinates) {
  const TemporaryFolder folder;
  const Mesh mesh = load_mesh(folder.write("a.obj", kQuadObj));
  save_mesh(folder.path() / "b.ply", mesh);
  const Mesh again = load_mesh(folder.path() / "b.ply");
  EXPECT_EQ(again.vertices, mesh.vertices);
  EXPECT_EQ(again.polygons, mesh.polygons);
  ASSERT_EQ(again.polygon_texcoords.size(), 1u);
  for (int corner = 0; corner < 4; ++corner) {
    EXPECT_EQ(again.texcoords.row(again.polygon_texcoords[0][corner]),
              mesh.texcoords.row(mesh.polygon_texcoords[0][corner]));
  }
}

TEST(SaveMesh, RefusesOtherExtensionsAndUnwritablePaths) {
  const TemporaryFolder folder;
  const Mesh mesh = load_mesh(folder.write("a.obj", kQuadObj));
  EXPECT_NE(message_of([&] { save_mesh(folder.path() / "a.xyz", mesh); }).find(".obj or .ply"),
            std::string::npos);
  EXPECT_THROW(save_mesh(folder.path() / "a.obj" / "b.obj", mesh), std::runtime_error);
}

TEST(Triangulate, CutsConcaveQuadsAndPolygonsWithinTheirOutline) {
  Eigen::MatrixXd points(8, 3);
  // An arrow head (quad, concave at 2) and a comb of eight corners.
  points << 0, 0, 0, 4, 0, 0, 1, 1, 0, 0, 4, 0, 6, 0, 0, 6, 5, 0, 3, 2, 0, 0, 5, 0;
  const auto area = [&](const std::vector<std::vector<int>>& polygons) {
    const Triangulation cut = triangulate(points, polygons);
    for (Eigen::Index f = 0; f < cut.faces.rows(); ++f) {
      const Eigen::Vector3d a = points.row(cut.faces(f, 0)), b = points.row(cut.faces(f, 1)),
                            c = points.row(cut.faces(f, 2));
      EXPECT_GE((b - a).cross(c - a).z(), 0.0);
    }
    return face_areas(points, cut.faces).sum();
  };
  EXPECT_NEAR(area({{0, 1, 2, 3}}), 4.0, 1e-12);
  EXPECT_NEAR(area({{1, 2, 3, 0}}), 4.0, 1e-12);
  EXPECT_NEAR(area({{0, 4, 5, 6, 7}}), 21.0, 1e-12);
  EXPECT_EQ(triangulate(points, {{0, 4, 5, 6, 7}, {0, 1}}).faces.rows(), 3);
}

TEST(MakeMesh, ChecksWhatItIsGiven) {
  const testing::Shape shape = testing::grid(3);
  EXPECT_THROW(make_mesh(shape.vertices, {{0, 1, 99}}, {}, {}, "m"), std::invalid_argument);
  EXPECT_THROW(make_mesh(shape.vertices, {}, {}, {}, "m"), std::invalid_argument);
  EXPECT_THROW(make_mesh(shape.vertices, {{0, 1, 2}}, {}, {{0, 0, 0}}, "m"), std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::mesh
