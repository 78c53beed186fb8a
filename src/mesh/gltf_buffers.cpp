#include "mesh/gltf_buffers.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>
#include <system_error>

#include "core/file.h"
#include "freetalk/core/error.h"

namespace freetalk::mesh {
namespace {

using nlohmann::json;

constexpr const char* kDamaged = "is damaged or cut short; export it again";

enum Component {
  kInt8 = 5120,
  kUint8 = 5121,
  kInt16 = 5122,
  kUint16 = 5123,
  kUint32 = 5125,
  kFloat = 5126
};

int64_t component_bytes(int64_t component) {
  switch (component) {
    case kInt8:
    case kUint8:
      return 1;
    case kInt16:
    case kUint16:
      return 2;
    case kUint32:
    case kFloat:
      return 4;
    default:
      return 0;
  }
}

template <class T>
T read_at(std::string_view bytes, size_t offset) {
  T value;
  std::memcpy(&value, bytes.data() + offset, sizeof(T));
  return value;
}

/// Signed integers reach -1 in two ways (glTF 2.0, Section 3.11).
template <class T>
double normalized(T value) {
  return std::max(static_cast<double>(value) / std::numeric_limits<T>::max(), -1.0);
}

std::string decode_base64(std::string_view text) {
  std::string bytes;
  bytes.reserve(text.size() / 4 * 3);
  uint32_t bits = 0;
  int count = 0;
  for (const char c : text) {
    int value = -1;
    if (c >= 'A' && c <= 'Z') value = c - 'A';
    if (c >= 'a' && c <= 'z') value = c - 'a' + 26;
    if (c >= '0' && c <= '9') value = c - '0' + 52;
    if (c == '+' || c == '-') value = 62;
    if (c == '/' || c == '_') value = 63;
    if (value < 0) continue;  // Padding and line breaks.
    bits = (bits << 6 | static_cast<uint32_t>(value)) & 0xFFFFFF;
    count += 6;
    if (count < 8) continue;
    count -= 8;
    bytes.push_back(static_cast<char>(bits >> count & 0xFF));
  }
  return bytes;
}

std::string decode_percent(std::string_view text) {
  const auto digit = [](char c) {
    return c >= '0' && c <= '9'   ? c - '0'
           : c >= 'a' && c <= 'f' ? c - 'a' + 10
           : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                  : -1;
  };
  std::string result;
  for (size_t i = 0; i < text.size(); ++i) {
    const int high = text[i] == '%' && i + 2 < text.size() ? digit(text[i + 1]) : -1;
    const int low = high >= 0 ? digit(text[i + 2]) : -1;
    if (low >= 0) {
      result.push_back(static_cast<char>(16 * high + low));
      i += 2;
    } else {
      result.push_back(text[i]);
    }
  }
  return result;
}

}  // namespace

int64_t type_width(const std::string& type) {
  return type == "SCALAR" ? 1 : type == "VEC2" ? 2 : type == "VEC3" ? 3 : type == "VEC4" ? 4 : 0;
}

GltfDocument::GltfDocument(const std::filesystem::path& path, const std::string& bytes)
    : path_(path) {
  constexpr size_t kHeader = 12, kChunkHeader = 8;
  constexpr uint32_t kJson = 0x4E4F534A, kBinary = 0x004E4942;
  if (bytes.compare(0, 4, "glTF") != 0) {
    parse(bytes);
    load_buffers({});
    unpack();
    return;
  }
  if (bytes.size() < kHeader + kChunkHeader) fail(kDamaged);
  if (read_at<uint32_t>(bytes, 4) != 2) fail("is not glTF of version 2; export it as glTF 2.0");
  std::string_view text, binary;
  std::string_view rest = std::string_view(bytes).substr(kHeader);
  while (rest.size() >= kChunkHeader) {
    const auto length = read_at<uint32_t>(rest, 0);
    const auto kind = read_at<uint32_t>(rest, 4);
    rest.remove_prefix(kChunkHeader);
    if (length > rest.size()) fail(kDamaged);
    if (kind == kJson && text.empty()) text = rest.substr(0, length);
    if (kind == kBinary && binary.empty()) binary = rest.substr(0, length);
    rest.remove_prefix(length);
  }
  parse(text);
  load_buffers(binary);
  unpack();
}

void GltfDocument::fail(const std::string& problem) const {
  throw std::runtime_error("mesh file " + path_.string() + " " + problem);
}

void GltfDocument::fail_damaged() const { fail(kDamaged); }

void GltfDocument::parse(std::string_view text) {
  root_ = json::parse(text.begin(), text.end(), nullptr, false);
  if (!root_.is_object()) fail("is damaged or not glTF; export it again");
  const auto asset = root_.find("asset");
  const bool second = asset != root_.end() && asset->is_object() &&
                      asset->value("version", std::string()).compare(0, 2, "2.") == 0;
  if (!second) fail("is not glTF of version 2; export it as glTF 2.0");
}

void GltfDocument::load_buffers(std::string_view binary_chunk) {
  for (const json& buffer : list("buffers")) {
    const auto uri = buffer.find("uri");
    if (uri == buffer.end()) {
      buffers_.emplace_back(buffers_.empty() ? binary_chunk : std::string_view());
    } else {
      buffers_.push_back(content_of(uri->get<std::string>()));
    }
  }
}

std::string GltfDocument::content_of(const std::string& uri) const {
  if (uri.compare(0, 5, "data:") == 0) {
    const size_t comma = uri.find(',');
    if (comma == std::string::npos) fail(kDamaged);
    return decode_base64(std::string_view(uri).substr(comma + 1));
  }
  const std::filesystem::path name = decode_percent(uri);
  const bool outside = name.is_absolute() || uri.find("://") != std::string::npos ||
                       std::find(name.begin(), name.end(), "..") != name.end();
  if (outside) fail("keeps its data outside its folder (" + uri + "); export it as .glb");
  const std::filesystem::path other = path_.parent_path() / name;
  std::error_code error;
  if (!std::filesystem::is_regular_file(other, error)) {
    fail("needs the file " + other.string() + ", which is not there; put it back or export .glb");
  }
  return core::read_text(other);
}

const json& GltfDocument::list(const json& parent, const char* key) const {
  static const json empty = json::array();
  if (!parent.is_object()) fail(kDamaged);
  const auto found = parent.find(key);
  if (found == parent.end()) return empty;
  if (!found->is_array()) fail(kDamaged);
  for (const json& element : *found) {
    if (!element.is_object()) fail(kDamaged);
  }
  return *found;
}

int64_t GltfDocument::whole(const json& object, const char* key, int64_t missing) const {
  const auto found = object.find(key);
  if (found == object.end()) {
    if (missing < 0) fail(kDamaged);
    return missing;
  }
  constexpr int64_t kLargest = int64_t{1} << 40;
  if (!found->is_number_unsigned() || found->get<uint64_t>() > kLargest) fail(kDamaged);
  return found->get<int64_t>();
}

int64_t GltfDocument::index(const json& object, const char* key, size_t size,
                            int64_t missing) const {
  const int64_t value = whole(object, key, missing);
  if (value >= static_cast<int64_t>(size)) fail(kDamaged);
  return value;
}

std::vector<int64_t> GltfDocument::indices(const json& object, const char* key, size_t size) const {
  std::vector<int64_t> result;
  const auto found = object.find(key);
  if (found == object.end()) return result;
  if (!found->is_array()) fail(kDamaged);
  for (const json& value : *found) {
    if (!value.is_number_unsigned() || value.get<uint64_t>() >= size) fail(kDamaged);
    result.push_back(value.get<int64_t>());
  }
  return result;
}

std::vector<double> GltfDocument::numbers(const json& object, const char* key, size_t count) const {
  const json& found = object.at(key);
  if (!found.is_array() || found.size() != count) fail(kDamaged);
  return found.get<std::vector<double>>();
}

std::string_view GltfDocument::view(int64_t index, int64_t offset) const {
  const json& views = list("bufferViews");
  if (index >= static_cast<int64_t>(views.size())) fail(kDamaged);
  const json& view = views[static_cast<size_t>(index)];
  const std::string_view bytes = bytes_of(view);
  if (offset > static_cast<int64_t>(bytes.size())) fail(kDamaged);
  return bytes.substr(static_cast<size_t>(offset));
}

std::string_view GltfDocument::bytes_of(const json& view) const {
  const auto& bytes = buffers_[static_cast<size_t>(index(view, "buffer", buffers_.size()))];
  const auto size = static_cast<int64_t>(bytes.size());
  const int64_t start = whole(view, "byteOffset", 0);
  const int64_t length = whole(view, "byteLength");
  if (start > size || length > size - start) fail(kDamaged);
  return std::string_view(bytes).substr(static_cast<size_t>(start), static_cast<size_t>(length));
}

void GltfDocument::add_buffer(std::string bytes) {
  root_["buffers"].push_back({{"byteLength", bytes.size()}});
  buffers_.push_back(std::move(bytes));
}

std::string GltfDocument::view_bytes(int64_t index) const { return std::string(view(index, 0)); }

const json& GltfDocument::accessor_at(int64_t index) const {
  const json& accessors = list("accessors");
  if (index >= static_cast<int64_t>(accessors.size())) fail(kDamaged);
  return accessors[static_cast<size_t>(index)];
}

GltfDocument::Source GltfDocument::source(const json& object, int64_t count, int64_t component,
                                          int64_t width) const {
  Source source;
  source.count = count;
  source.component = component;
  source.width = width;
  const int64_t element = component_bytes(component) * width;
  if (element == 0) fail("has numbers of unknown type; export it again");
  const int64_t view_index = whole(object, "bufferView");
  source.bytes = view(view_index, whole(object, "byteOffset", 0));
  source.stride = whole(list("bufferViews")[static_cast<size_t>(view_index)], "byteStride", 0);
  if (source.stride == 0) source.stride = element;
  const auto available = static_cast<int64_t>(source.bytes.size());
  const bool fits =
      count == 0 || (available >= element && count - 1 <= (available - element) / source.stride);
  if (!fits) fail(kDamaged);
  return source;
}

double GltfDocument::number_at(const Source& source, int64_t element, int64_t part) const {
  const auto offset =
      static_cast<size_t>(element * source.stride + part * component_bytes(source.component));
  const auto value = [&](auto raw) {
    return source.normalized ? normalized(raw) : static_cast<double>(raw);
  };
  switch (source.component) {
    case kInt8:
      return value(read_at<int8_t>(source.bytes, offset));
    case kUint8:
      return value(read_at<uint8_t>(source.bytes, offset));
    case kInt16:
      return value(read_at<int16_t>(source.bytes, offset));
    case kUint16:
      return value(read_at<uint16_t>(source.bytes, offset));
    case kUint32:
      return value(read_at<uint32_t>(source.bytes, offset));
    default:
      return static_cast<double>(read_at<float>(source.bytes, offset));
  }
}

int64_t GltfDocument::num_bytes() const {
  int64_t total = 0;
  for (const std::string& buffer : buffers_) total += static_cast<int64_t>(buffer.size());
  return total;
}

int64_t GltfDocument::accessor_count(int64_t accessor) const {
  const int64_t count = whole(accessor_at(accessor), "count");
  // Every element takes at least a byte, so a larger count is damage (or an attack on the memory).
  if (count > num_bytes()) fail(kDamaged);
  return count;
}

int64_t GltfDocument::accessor_width(int64_t accessor) const {
  return type_width(accessor_at(accessor).value("type", std::string()));
}

std::vector<double> GltfDocument::accessor_numbers(int64_t accessor, int64_t width) const {
  const json& object = accessor_at(accessor);
  const int64_t count = accessor_count(accessor);
  if (type_width(object.value("type", std::string())) != width) fail(kDamaged);
  const int64_t component = whole(object, "componentType");
  if (component_bytes(component) == 0) fail("has numbers of unknown type; export it again");
  Source from;
  from.component = component;
  from.width = width;
  if (object.contains("bufferView")) from = source(object, count, component, width);
  from.normalized = object.value("normalized", false) && component != kFloat;
  std::vector<double> values(static_cast<size_t>(count * width), 0.0);
  if (!from.bytes.empty()) {
    for (int64_t i = 0; i < count; ++i) {
      for (int64_t part = 0; part < width; ++part) {
        values[static_cast<size_t>(i * width + part)] = number_at(from, i, part);
      }
    }
  }
  if (object.contains("sparse")) apply_sparse(object, from, values);
  return values;
}

void GltfDocument::apply_sparse(const json& accessor, const Source& like,
                                std::vector<double>& values) const {
  const json& sparse = accessor["sparse"];
  const int64_t count = whole(sparse, "count");
  const json& where = sparse.at("indices");
  const Source indices = source(where, count, whole(where, "componentType"), 1);
  Source replacing = source(sparse.at("values"), count, like.component, like.width);
  replacing.normalized = like.normalized;
  const auto elements = static_cast<double>(values.size()) / static_cast<double>(like.width);
  for (int64_t i = 0; i < count; ++i) {
    const double element = number_at(indices, i, 0);
    if (!(element >= 0.0 && element < elements)) fail(kDamaged);
    for (int64_t part = 0; part < like.width; ++part) {
      const int64_t slot = static_cast<int64_t>(element) * like.width + part;
      values[static_cast<size_t>(slot)] = number_at(replacing, i, part);
    }
  }
}

std::vector<int64_t> GltfDocument::accessor_indices(int64_t accessor) const {
  const int64_t component = whole(accessor_at(accessor), "componentType");
  if (component != kUint8 && component != kUint16 && component != kUint32) fail(kDamaged);
  const std::vector<double> values = accessor_numbers(accessor, 1);
  return {values.begin(), values.end()};
}

}  // namespace freetalk::mesh
