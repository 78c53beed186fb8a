// The bytes of a glTF 2.0 file [Khronos]: accessors over one buffer, and its two containers.
#pragma once

#include <ATen/core/Tensor.h>
#include <nlohmann/json.hpp>

#include <cstdint>
#include <filesystem>
#include <ostream>
#include <string>
#include <vector>

namespace freetalk::animation {

using Json = nlohmann::ordered_json;

/// What an accessor says of its numbers; their component type is the tensor's.
struct GltfLayout {
  const char* type = "VEC3";
  int target = 0;  ///< kArrayBuffer, kElementArrayBuffer, 0 for neither
  bool bounds = false;
  bool normalized = false;
};

inline constexpr int kArrayBuffer = 34962, kElementArrayBuffer = 34963;

/// Collects buffer views; their bytes stay where they are until written.
class GltfBuffer {
 public:
  Json views = Json::array(), accessors = Json::array();

  /// Adds an accessor over `data` (N, W) of float32, int32 (as uint32), int16, uint16, int8 or
  /// uint8. Rows begin at multiples of four bytes. @return its index.
  int add(const at::Tensor& data, const GltfLayout& layout);
  /// Adds a view of any bytes. @return its index.
  int add_bytes(const std::string& bytes);
  /// Adds bytes that are no view of their own. @return where they begin.
  int64_t append(const std::string& bytes);

  int64_t bytes() const { return bytes_; }
  void write(std::ostream& out) const;

 private:
  int64_t append(at::Tensor data);

  int64_t bytes_ = 0;
  std::vector<at::Tensor> blocks_;
};

/// The name of a file in the same folder as a URI, percent-encoded.
std::string uri_of(const std::filesystem::path& file);

/// Writes a .glb, or a .gltf with its .bin beside. @return number of files.
int write_gltf(const std::filesystem::path& path, Json root, const GltfBuffer& buffer);

}  // namespace freetalk::animation
