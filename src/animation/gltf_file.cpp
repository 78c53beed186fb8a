#include "gltf_file.h"

#include <ATen/ATen.h>

#include <cctype>
#include <cstring>
#include <utility>

#include "core/file.h"
#include "freetalk/core/error.h"

namespace freetalk::animation {
namespace {

int component_of(at::ScalarType type) {
  switch (type) {
    case at::kChar:
      return 5120;
    case at::kByte:
      return 5121;
    case at::kShort:
      return 5122;
    case at::kUInt16:
      return 5123;
    case at::kInt:
      return 5125;
    default:
      FREETALK_CHECK(type == at::kFloat, "glTF holds no numbers of type ", type);
      return 5126;
  }
}

std::vector<double> to_list(const at::Tensor& values) {
  const auto wide = values.to(at::kDouble).contiguous();
  return {wide.data_ptr<double>(), wide.data_ptr<double>() + wide.numel()};
}

void put_u32(std::ostream& out, uint64_t value) {
  const char bytes[4] = {static_cast<char>(value), static_cast<char>(value >> 8),
                         static_cast<char>(value >> 16), static_cast<char>(value >> 24)};
  out.write(bytes, 4);
}

void write_glb(const std::filesystem::path& path, const Json& root, const GltfBuffer& buffer) {
  std::string json = root.dump();
  json.append((4 - json.size() % 4) % 4, ' ');
  const uint64_t total = 12 + 8 + json.size() + 8 + buffer.bytes();
  FREETALK_RUNTIME_CHECK(
      total <= UINT32_MAX, path.string(),
      ": would exceed the 4 GB of a .glb; lower max_morph_targets or write .npz");
  core::write_file_atomic(path, [&](std::ostream& out) {
    out.write("glTF", 4);
    put_u32(out, 2);
    put_u32(out, total);
    put_u32(out, json.size());
    out.write("JSON", 4);
    out.write(json.data(), static_cast<std::streamsize>(json.size()));
    put_u32(out, buffer.bytes());
    out.write("BIN\0", 4);
    buffer.write(out);
  });
}

}  // namespace

int GltfBuffer::add(const at::Tensor& data, const GltfLayout& layout) {
  const int64_t count = data.size(0), row = data.size(1) * data.element_size();
  const int64_t stride = layout.target == kArrayBuffer ? (row + 3) / 4 * 4 : row;
  at::Tensor rows = data;
  if (stride != row) {
    rows = at::zeros({count, static_cast<int64_t>(stride / data.element_size())}, data.options());
    rows.slice(1, 0, data.size(1)).copy_(data);
  }
  Json view = {{"buffer", 0}, {"byteOffset", bytes_}, {"byteLength", count * stride}};
  if (stride != row) view["byteStride"] = stride;
  if (layout.target != 0) view["target"] = layout.target;
  views.push_back(std::move(view));
  Json accessor = {{"bufferView", views.size() - 1},
                   {"componentType", component_of(data.scalar_type())},
                   {"count", count},
                   {"type", layout.type}};
  if (layout.normalized) accessor["normalized"] = true;
  if (layout.bounds) {
    accessor["min"] = to_list(std::get<0>(data.min(0)));
    accessor["max"] = to_list(std::get<0>(data.max(0)));
  }
  accessors.push_back(std::move(accessor));
  append(std::move(rows));
  return static_cast<int>(accessors.size()) - 1;
}

int GltfBuffer::add_bytes(const std::string& bytes) {
  const int64_t begin = append(bytes);
  views.push_back({{"buffer", 0}, {"byteOffset", begin}, {"byteLength", bytes.size()}});
  return static_cast<int>(views.size()) - 1;
}

int64_t GltfBuffer::append(const std::string& bytes) {
  return append(at::from_blob(const_cast<char*>(bytes.data()), {static_cast<int64_t>(bytes.size())},
                              at::kByte)
                    .clone());
}

int64_t GltfBuffer::append(at::Tensor data) {
  const int64_t begin = bytes_;
  blocks_.push_back(data.contiguous());
  bytes_ += (static_cast<int64_t>(blocks_.back().nbytes()) + 3) / 4 * 4;
  return begin;
}

void GltfBuffer::write(std::ostream& out) const {
  for (const auto& block : blocks_) {
    const auto size = static_cast<std::streamsize>(block.nbytes());
    out.write(static_cast<const char*>(block.data_ptr()), size);
    out.write("\0\0\0", (4 - size % 4) % 4);
  }
}

std::string uri_of(const std::filesystem::path& file) {
  std::string uri;
  for (const char c : file.filename().string()) {
    const bool plain = std::isalnum(static_cast<unsigned char>(c)) != 0;
    if (plain || std::strchr("-._~", c) != nullptr) {
      uri += c;
      continue;
    }
    constexpr char kDigits[] = "0123456789ABCDEF";
    const auto byte = static_cast<unsigned char>(c);
    uri += {'%', kDigits[byte / 16], kDigits[byte % 16]};
  }
  return uri;
}

int write_gltf(const std::filesystem::path& path, Json root, const GltfBuffer& buffer) {
  root["accessors"] = buffer.accessors;
  root["bufferViews"] = buffer.views;
  root["buffers"] = Json::array({{{"byteLength", buffer.bytes()}}});
  if (core::lower_extension(path) == "glb") {
    write_glb(path, root, buffer);
    return 1;
  }
  const auto binary = std::filesystem::path(path).replace_extension(".bin");
  root["buffers"][0]["uri"] = uri_of(binary);
  core::write_file_atomic(binary, [&](std::ostream& out) { buffer.write(out); });
  core::write_file_atomic(path, root.dump());
  return 2;
}

}  // namespace freetalk::animation
