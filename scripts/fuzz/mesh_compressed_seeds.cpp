// Writes small glTF files compressed by Draco and by meshoptimizer, everything inside, into a folder.
#include <draco/compression/encode.h>
#include <draco/mesh/triangle_soup_mesh_builder.h>
#include <meshoptimizer.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace {

using nlohmann::json;

constexpr uint32_t kSide = 5;
constexpr size_t kPoints = kSide * kSide;

std::vector<float> points() {
  std::vector<float> values;
  for (uint32_t v = 0; v < kPoints; ++v) {
    const auto x = static_cast<float>(v % kSide), y = static_cast<float>(v / kSide);
    values.insert(values.end(), {0.1f * x, 0.1f * y, 0.01f * x * y});
  }
  return values;
}

std::vector<uint32_t> corners() {
  std::vector<uint32_t> values;
  for (uint32_t v = 0; v + kSide < kPoints; ++v) {
    if (v % kSide == kSide - 1) continue;
    values.insert(values.end(), {v, v + 1, v + kSide + 1, v, v + kSide + 1, v + kSide});
  }
  return values;
}

json document() {
  json root = json::parse(R"({
    "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
    "accessors": [{"componentType": 5126, "type": "VEC3"}, {"componentType": 5125, "type": "SCALAR"}]})");
  root["accessors"][0]["count"] = kPoints;
  root["accessors"][1]["count"] = corners().size();
  return root;
}

/// A .glb, so that mutations reach the compressed bytes.
void write(const std::filesystem::path& path, json root, std::string bytes) {
  root["buffers"][0]["byteLength"] = bytes.size();
  std::string text = root.dump();
  text.append((4 - text.size() % 4) % 4, ' ');
  bytes.append((4 - bytes.size() % 4) % 4, '\0');
  std::ofstream file(path, std::ios::binary);
  const auto put = [&](size_t number) {
    for (int shift = 0; shift < 32; shift += 8) file.put(static_cast<char>(number >> shift));
  };
  file << "glTF";
  put(2);
  put(12 + 8 + text.size() + 8 + bytes.size());
  put(text.size());
  file << "JSON" << text;
  put(bytes.size());
  file << "BIN" << '\0' << bytes;
}

void write_draco(const std::filesystem::path& path) {
  const std::vector<float> places = points();
  const std::vector<uint32_t> faces = corners();
  draco::TriangleSoupMeshBuilder builder;
  builder.Start(static_cast<int>(faces.size() / 3));
  const int attribute =
      builder.AddAttribute(draco::GeometryAttribute::POSITION, 3, draco::DT_FLOAT32);
  for (uint32_t f = 0; f < faces.size() / 3; ++f) {
    const auto corner = [&](uint32_t k) { return &places[3 * faces[3 * f + k]]; };
    builder.SetAttributeValuesForFace(attribute, draco::FaceIndex(f), corner(0), corner(1),
                                      corner(2));
  }
  const auto mesh = builder.Finalize();
  draco::Encoder encoder;
  encoder.SetAttributeQuantization(draco::GeometryAttribute::POSITION, 12);
  draco::EncoderBuffer buffer;
  encoder.EncodeMeshToBuffer(*mesh, &buffer);
  json root = document();
  root["extensionsUsed"] = root["extensionsRequired"] = {"KHR_draco_mesh_compression"};
  root["bufferViews"] = {{{"buffer", 0}, {"byteLength", buffer.size()}}};
  root["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"] = {
      {"bufferView", 0}, {"attributes", {{"POSITION", mesh->attribute(attribute)->unique_id()}}}};
  write(path, root, {buffer.data(), buffer.size()});
}

void write_meshopt(const std::filesystem::path& path) {
  const std::vector<float> places = points();
  const std::vector<uint32_t> faces = corners();
  std::string first(meshopt_encodeVertexBufferBound(kPoints, 12), '\0');
  first.resize(meshopt_encodeVertexBuffer(reinterpret_cast<unsigned char*>(first.data()),
                                          first.size(), places.data(), kPoints, 12));
  std::string second(meshopt_encodeIndexBufferBound(faces.size(), kPoints), '\0');
  second.resize(meshopt_encodeIndexBuffer(reinterpret_cast<unsigned char*>(second.data()),
                                          second.size(), faces.data(), faces.size()));
  json root = document();
  root["extensionsUsed"] = {"EXT_meshopt_compression"};
  const size_t plain = 12 * kPoints + 4 * faces.size();
  root["buffers"] = {{{"byteLength", 0}}, {{"byteLength", plain}}};
  root["bufferViews"] = {
      {{"buffer", 1}, {"byteLength", 12 * kPoints}, {"byteStride", 12}},
      {{"buffer", 1}, {"byteOffset", 12 * kPoints}, {"byteLength", 4 * faces.size()}}};
  root["bufferViews"][0]["extensions"]["EXT_meshopt_compression"] = {
      {"buffer", 0},      {"byteLength", first.size()}, {"byteStride", 12},
      {"count", kPoints}, {"mode", "ATTRIBUTES"}};
  root["bufferViews"][1]["extensions"]["EXT_meshopt_compression"] = {
      {"buffer", 0},     {"byteOffset", first.size()}, {"byteLength", second.size()},
      {"byteStride", 4}, {"count", faces.size()},      {"mode", "TRIANGLES"}};
  root["accessors"][0]["bufferView"] = 0;
  root["accessors"][1]["bufferView"] = 1;
  write(path, root, first + second);
}

}  // namespace

int main(int, char** argv) {
  const std::filesystem::path folder = argv[1];
  write_draco(folder / "draco.glb");
  write_meshopt(folder / "meshopt.glb");
}
