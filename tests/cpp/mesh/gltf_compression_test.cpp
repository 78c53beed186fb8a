#include <draco/compression/encode.h>
#include <draco/mesh/triangle_soup_mesh_builder.h>
#include <gtest/gtest.h>
#include <meshoptimizer.h>

#include <nlohmann/json.hpp>

#include "freetalk/mesh/mesh.h"
#include "shapes.h"

namespace freetalk::mesh {
namespace {

using freetalk::testing::TemporaryFolder;
using nlohmann::json;

/// A bent sheet, as single numbers.
struct Sheet {
  std::vector<float> points;  // (V, 3)
  std::vector<uint32_t> corners;
};

Sheet sheet() {
  const auto flat = freetalk::testing::grid(9, 0.2, 0.1);
  Sheet result;
  for (Eigen::Index v = 0; v < flat.vertices.rows(); ++v) {
    const double x = flat.vertices(v, 0), y = flat.vertices(v, 1);
    for (const double value : {x, y, 0.05 * std::sin(20 * x)}) {
      result.points.push_back(static_cast<float>(value));
    }
  }
  for (Eigen::Index f = 0; f < flat.faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) result.corners.push_back(static_cast<uint32_t>(flat.faces(f, k)));
  }
  return result;
}

json document(size_t points, size_t corners, size_t bytes) {
  json root = json::parse(R"({
    "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
    "accessors": [{"componentType": 5126, "type": "VEC3"}, {"componentType": 5123, "type": "SCALAR"}],
    "buffers": [{"uri": "data.bin"}], "bufferViews": [{"buffer": 0}]})");
  root["accessors"][0]["count"] = points;
  root["accessors"][1]["count"] = corners;
  root["buffers"][0]["byteLength"] = bytes;
  return root;
}

/// Corners of all triangles, (3 F, 3), in an order that no encoder changes.
std::vector<std::array<double, 9>> triangles(const Mesh& mesh) {
  std::vector<std::array<double, 9>> result;
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) {
    std::array<std::array<double, 3>, 3> corners;
    for (int k = 0; k < 3; ++k) {
      for (int axis = 0; axis < 3; ++axis) {
        corners[k][axis] = std::round(1e4 * mesh.vertices(mesh.faces(f, k), axis));
      }
    }
    std::rotate(corners.begin(), std::min_element(corners.begin(), corners.end()), corners.end());
    std::array<double, 9> flat;
    for (int n = 0; n < 9; ++n) flat[n] = corners[n / 3][n % 3];
    result.push_back(flat);
  }
  std::sort(result.begin(), result.end());
  return result;
}

Mesh plain(const Sheet& sheet) {
  Mesh mesh;
  const auto count = static_cast<Eigen::Index>(sheet.points.size() / 3);
  mesh.vertices = Eigen::Map<const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>>(
                      sheet.points.data(), count, 3)
                      .cast<double>();
  mesh.faces.resize(static_cast<Eigen::Index>(sheet.corners.size() / 3), 3);
  for (size_t n = 0; n < sheet.corners.size(); ++n) {
    mesh.faces(static_cast<Eigen::Index>(n / 3), static_cast<Eigen::Index>(n % 3)) =
        static_cast<int>(sheet.corners[n]);
  }
  return mesh;
}

std::string draco_bytes(const Sheet& sheet, int& position_id) {
  const auto faces = static_cast<int>(sheet.corners.size() / 3);
  draco::TriangleSoupMeshBuilder builder;
  builder.Start(faces);
  const int attribute =
      builder.AddAttribute(draco::GeometryAttribute::POSITION, 3, draco::DT_FLOAT32);
  for (int f = 0; f < faces; ++f) {
    const auto corner = [&](int k) {
      return sheet.points.data() + 3 * sheet.corners[static_cast<size_t>(3 * f + k)];
    };
    builder.SetAttributeValuesForFace(attribute, draco::FaceIndex(static_cast<uint32_t>(f)),
                                      corner(0), corner(1), corner(2));
  }
  const auto mesh = builder.Finalize();
  position_id = static_cast<int>(mesh->attribute(attribute)->unique_id());
  draco::Encoder encoder;
  encoder.SetAttributeQuantization(draco::GeometryAttribute::POSITION, 16);
  draco::EncoderBuffer buffer;
  EXPECT_TRUE(encoder.EncodeMeshToBuffer(*mesh, &buffer).ok());
  return {buffer.data(), buffer.size()};
}

TEST(GltfCompression, ReadsDraco) {
  const TemporaryFolder folder;
  const Sheet wanted = sheet();
  int id = 0;
  const std::string bytes = draco_bytes(wanted, id);
  json root = document(wanted.points.size() / 3, wanted.corners.size(), bytes.size());
  root["bufferViews"][0]["byteLength"] = bytes.size();
  root["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"] = {
      {"bufferView", 0}, {"attributes", {{"POSITION", id}}}};
  folder.write("data.bin", bytes);
  const Mesh found = load_mesh(folder.write("draco.gltf", root.dump()));
  EXPECT_EQ(found.num_vertices(), 81);
  EXPECT_EQ(triangles(found), triangles(plain(wanted)));

  folder.write("data.bin", bytes.substr(0, bytes.size() / 2));
  root["bufferViews"][0]["byteLength"] = bytes.size() / 2;
  EXPECT_THROW(load_mesh(folder.write("half.gltf", root.dump())), std::runtime_error);
  root["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"]["attributes"]
      ["POSITION"] = id + 5;
  folder.write("data.bin", bytes);
  root["bufferViews"][0]["byteLength"] = bytes.size();
  EXPECT_THROW(load_mesh(folder.write("other.gltf", root.dump())), std::runtime_error);
}

TEST(GltfCompression, ReadsMeshopt) {
  const TemporaryFolder folder;
  const Sheet wanted = sheet();
  const size_t points = wanted.points.size() / 3, corners = wanted.corners.size();
  std::string first(meshopt_encodeVertexBufferBound(points, 12), '\0');
  first.resize(meshopt_encodeVertexBuffer(reinterpret_cast<unsigned char*>(first.data()),
                                          first.size(), wanted.points.data(), points, 12));
  std::string second(meshopt_encodeIndexBufferBound(corners, points), '\0');
  second.resize(meshopt_encodeIndexBuffer(reinterpret_cast<unsigned char*>(second.data()),
                                          second.size(), wanted.corners.data(), corners));
  json root = document(points, corners, first.size() + second.size());
  root["buffers"].push_back({{"byteLength", 12 * points + 2 * corners}});  // of readers without
  const auto packed = [](size_t offset, size_t length, size_t stride, size_t count,
                         const char* mode) {
    return json{{"buffer", 0},          {"byteOffset", offset}, {"byteLength", length},
                {"byteStride", stride}, {"count", count},       {"mode", mode}};
  };
  root["bufferViews"] =
      json::array({{{"buffer", 1}, {"byteLength", 12 * points}, {"byteStride", 12}},
                   {{"buffer", 1}, {"byteOffset", 12 * points}, {"byteLength", 2 * corners}}});
  root["bufferViews"][0]["extensions"]["EXT_meshopt_compression"] =
      packed(0, first.size(), 12, points, "ATTRIBUTES");
  root["bufferViews"][1]["extensions"]["EXT_meshopt_compression"] =
      packed(first.size(), second.size(), 2, corners, "TRIANGLES");
  root["accessors"][0]["bufferView"] = 0;
  root["accessors"][1]["bufferView"] = 1;
  folder.write("data.bin", first + second);
  const Mesh found = load_mesh(folder.write("meshopt.gltf", root.dump()));
  EXPECT_EQ(triangles(found), triangles(plain(wanted)));

  const auto refuses = [&](const char* key, const json& value) {
    json changed = root;
    changed["bufferViews"][0]["extensions"]["EXT_meshopt_compression"][key] = value;
    EXPECT_THROW(load_mesh(folder.write("changed.gltf", changed.dump())), std::runtime_error)
        << key;
  };
  refuses("count", 1u << 30);
  refuses("byteLength", 10);
  refuses("byteLength", 1u << 30);
  refuses("byteStride", 0);
  refuses("mode", "OTHER");
  refuses("filter", "QUATERNION");
}

}  // namespace
}  // namespace freetalk::mesh
