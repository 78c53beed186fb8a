// Compressed glTF unpacked: KHR_draco_mesh_compression by Draco, EXT_meshopt_compression by
// meshoptimizer. What is read afterwards is plain glTF.
#include <draco/compression/decode.h>
#include <meshoptimizer.h>

#include <algorithm>
#include <cstring>
#include <map>

#include "gltf_buffers.h"

namespace freetalk::mesh {
namespace {

using nlohmann::json;

constexpr const char* kDraco = "KHR_draco_mesh_compression";
constexpr const char* kMeshopt = "EXT_meshopt_compression";
constexpr uint64_t kIndexComponent = 5125;  // unsigned, 32 bits
// More numbers than compressed bytes could hold are damage (or an attack on the memory).
constexpr int64_t kMostExpansion = 4096;

/// Numbers of a Draco attribute as the accessor has them.
template <class T>
bool convert(const draco::PointAttribute& attribute, uint32_t num_points, int width,
             std::string& bytes) {
  bytes.resize(static_cast<size_t>(num_points) * static_cast<size_t>(width) * sizeof(T));
  auto* to = reinterpret_cast<T*>(bytes.data());
  for (uint32_t point = 0; point < num_points; ++point, to += width) {
    const auto value = attribute.mapped_index(draco::PointIndex(point));
    if (!attribute.ConvertValue<T>(value, static_cast<int8_t>(width), to)) return false;
  }
  return true;
}

bool convert(const draco::PointAttribute& attribute, uint32_t num_points, int width,
             int64_t component, std::string& bytes) {
  switch (component) {
    case 5120:
      return convert<int8_t>(attribute, num_points, width, bytes);
    case 5121:
      return convert<uint8_t>(attribute, num_points, width, bytes);
    case 5122:
      return convert<int16_t>(attribute, num_points, width, bytes);
    case 5123:
      return convert<uint16_t>(attribute, num_points, width, bytes);
    case 5125:
      return convert<uint32_t>(attribute, num_points, width, bytes);
    case 5126:
      return convert<float>(attribute, num_points, width, bytes);
    default:
      return false;
  }
}

/// Undoes a filter of meshopt in place.
bool unfilter(const std::string& filter, std::string& bytes, size_t count, size_t stride) {
  if (filter == "NONE") return true;
  if (filter == "OCTAHEDRAL" && (stride == 4 || stride == 8)) {
    meshopt_decodeFilterOct(bytes.data(), count, stride);
  } else if (filter == "QUATERNION" && stride == 8) {
    meshopt_decodeFilterQuat(bytes.data(), count, stride);
  } else if (filter == "EXPONENTIAL" && stride % 4 == 0) {
    meshopt_decodeFilterExp(bytes.data(), count, stride);
  } else {
    return false;
  }
  return true;
}

}  // namespace

void GltfDocument::unpack() {
  const auto packed = [](const json& object, const char* extension) {
    const auto found = object.find("extensions");
    return found != object.end() && found->is_object() && found->contains(extension);
  };
  for (size_t view = 0; view < list("bufferViews").size(); ++view) {
    if (packed(root_["bufferViews"][view], kMeshopt)) unpack_view(root_["bufferViews"][view]);
  }
  for (size_t mesh = 0; mesh < list("meshes").size(); ++mesh) {
    for (size_t part = 0; part < list(root_["meshes"][mesh], "primitives").size(); ++part) {
      json& primitive = root_["meshes"][mesh]["primitives"][part];
      if (packed(primitive, kDraco)) unpack_primitive(primitive);
    }
  }
  for (const char* names : {"extensionsUsed", "extensionsRequired"}) {
    if (!root_.contains(names) || !root_[names].is_array()) continue;
    json others = json::array();
    for (const json& name : root_[names]) {
      if (name != kDraco && name != kMeshopt) others.push_back(name);
    }
    if (others.empty()) {
      root_.erase(names);
    } else {
      root_[names] = std::move(others);
    }
  }
}

void GltfDocument::unpack_view(json& view) {
  const json packed = view["extensions"][kMeshopt];
  const std::string_view from = bytes_of(packed);
  const auto count = static_cast<size_t>(whole(packed, "count"));
  const auto stride = static_cast<size_t>(whole(packed, "byteStride"));
  const std::string mode = packed.value("mode", "");
  const bool fits = stride > 0 && stride <= 256 &&
                    count <= kMostExpansion * std::max<size_t>(from.size(), 1) / stride;
  if (!fits) fail_damaged();
  std::string bytes(count * stride, '\0');
  const auto* data = reinterpret_cast<const unsigned char*>(from.data());
  int status = -1;
  if (mode == "ATTRIBUTES" && stride % 4 == 0) {
    status = meshopt_decodeVertexBuffer(bytes.data(), count, stride, data, from.size());
  } else if (mode == "TRIANGLES" && count % 3 == 0 && (stride == 2 || stride == 4)) {
    status = meshopt_decodeIndexBuffer(bytes.data(), count, stride, data, from.size());
  } else if (mode == "INDICES" && (stride == 2 || stride == 4)) {
    status = meshopt_decodeIndexSequence(bytes.data(), count, stride, data, from.size());
  }
  if (status != 0 || !unfilter(packed.value("filter", "NONE"), bytes, count, stride)) {
    fail_damaged();
  }
  view.erase("byteOffset");
  view["byteLength"] = bytes.size();
  view["buffer"] = buffers_.size();
  if (mode == "ATTRIBUTES") view["byteStride"] = stride;
  view["extensions"].erase(kMeshopt);
  add_buffer(std::move(bytes));
}

void GltfDocument::unpack_primitive(json& primitive) {
  const json packed = primitive["extensions"][kDraco];
  const std::string_view from = view(whole(packed, "bufferView"), 0);
  draco::DecoderBuffer buffer;
  buffer.Init(from.data(), from.size());
  draco::Decoder decoder;
  auto decoded = decoder.DecodeMeshFromBuffer(&buffer);
  if (!decoded.ok()) fail_damaged();
  const std::unique_ptr<draco::Mesh> mesh = std::move(decoded).value();

  if (primitive.contains("indices")) {
    std::string bytes(size_t{12} * mesh->num_faces(), '\0');
    for (uint32_t face = 0; face < mesh->num_faces(); ++face) {
      for (uint32_t corner = 0; corner < 3; ++corner) {
        const uint32_t point = mesh->face(draco::FaceIndex(face))[corner].value();
        std::memcpy(bytes.data() + size_t{4} * (3 * face + corner), &point, sizeof(point));
      }
    }
    json& accessor = accessor_to_fill(primitive["indices"]);
    accessor["componentType"] = kIndexComponent;
    accessor["count"] = 3 * static_cast<uint64_t>(mesh->num_faces());
    fill(accessor, std::move(bytes));
  }
  for (const auto& [name, id] : packed.at("attributes").items()) {
    if (!id.is_number_unsigned() || !primitive.at("attributes").contains(name)) fail_damaged();
    const draco::PointAttribute* attribute = mesh->GetAttributeByUniqueId(id.get<uint32_t>());
    json& accessor = accessor_to_fill(primitive["attributes"][name]);
    const int64_t width = type_width(accessor.value("type", std::string()));
    std::string bytes;
    if (attribute == nullptr || width == 0 ||
        !convert(*attribute, mesh->num_points(), static_cast<int>(width),
                 whole(accessor, "componentType"), bytes)) {
      fail_damaged();
    }
    accessor["count"] = static_cast<uint64_t>(mesh->num_points());
    fill(accessor, std::move(bytes));
  }
  primitive["extensions"].erase(kDraco);
}

json& GltfDocument::accessor_to_fill(const json& index) {
  if (!index.is_number_unsigned()) fail_damaged();
  accessor_at(index.get<int64_t>());  // is there
  return root_["accessors"][index.get<size_t>()];
}

void GltfDocument::fill(json& accessor, std::string bytes) {
  accessor["bufferView"] = list("bufferViews").size();
  accessor.erase("byteOffset");
  root_["bufferViews"].push_back({{"buffer", buffers_.size()}, {"byteLength", bytes.size()}});
  add_buffer(std::move(bytes));
}

}  // namespace freetalk::mesh
