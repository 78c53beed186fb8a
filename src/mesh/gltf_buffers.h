// The JSON of a glTF file and the numbers its accessors point at.
#pragma once

#include <nlohmann/json.hpp>

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace freetalk::mesh {

/// Everything is checked against what the file really holds; every failure is a std::runtime_error
/// that names the file, or a json::exception.
class GltfDocument {
 public:
  /// @param bytes the content of `path`, glTF text or GLB. Buffers in other files are read from the
  /// same folder.
  GltfDocument(const std::filesystem::path& path, const std::string& bytes);

  [[noreturn]] void fail(const std::string& problem) const;

  const nlohmann::json& root() const { return root_; }
  /// A list of objects by name; an empty one if it is not there.
  const nlohmann::json& list(const char* key) const { return list(root_, key); }
  const nlohmann::json& list(const nlohmann::json& parent, const char* key) const;
  /// A whole number >= 0; `missing` if it is not there, which must be if `missing` is negative.
  int64_t whole(const nlohmann::json& object, const char* key, int64_t missing = -1) const;
  /// The same, below `size`.
  int64_t index(const nlohmann::json& object, const char* key, size_t size,
                int64_t missing = -1) const;
  /// A list of whole numbers below `size`; an empty one if it is not there.
  std::vector<int64_t> indices(const nlohmann::json& object, const char* key, size_t size) const;
  /// Exactly `count` numbers.
  std::vector<double> numbers(const nlohmann::json& object, const char* key, size_t count) const;

  /// What a buffer view holds.
  std::string view_bytes(int64_t index) const;
  const std::vector<std::string>& buffers() const { return buffers_; }
  /// The content of a URI: data, or a file in the folder. @throws std::runtime_error otherwise.
  std::string content_of(const std::string& uri) const;
  /// Bytes of all buffers.
  int64_t num_bytes() const;
  int64_t accessor_count(int64_t accessor) const;
  /// Numbers in an element, 0 for an unknown type.
  int64_t accessor_width(int64_t accessor) const;
  /// All elements of an accessor of `width` numbers each, normalised where it says so.
  std::vector<double> accessor_numbers(int64_t accessor, int64_t width) const;
  /// All elements of an accessor of single unsigned numbers.
  std::vector<int64_t> accessor_indices(int64_t accessor) const;

 private:
  struct Source {
    std::string_view bytes;  ///< From the first element on.
    int64_t stride = 0;
    int64_t count = 0;
    int64_t component = 0;
    int64_t width = 0;
    bool normalized = false;
  };

  [[noreturn]] void fail_damaged() const;
  void parse(std::string_view text);
  /// Replaces compressed views and primitives by plain ones (gltf_compression.cpp).
  void unpack();
  void unpack_view(nlohmann::json& view);
  void unpack_primitive(nlohmann::json& primitive);
  nlohmann::json& accessor_to_fill(const nlohmann::json& index);
  void fill(nlohmann::json& accessor, std::string bytes);
  /// The next of the document's buffers, which JSON and bytes both list.
  void add_buffer(std::string bytes);
  /// The part of a buffer that a view, or a compressed one, spans.
  std::string_view bytes_of(const nlohmann::json& view) const;
  void load_buffers(std::string_view binary_chunk);
  std::string_view view(int64_t index, int64_t offset) const;
  const nlohmann::json& accessor_at(int64_t index) const;
  /// Elements of `object`'s buffer view, checked to lie within it.
  Source source(const nlohmann::json& object, int64_t count, int64_t component,
                int64_t width) const;
  double number_at(const Source& source, int64_t element, int64_t part) const;
  void apply_sparse(const nlohmann::json& accessor, const Source& like,
                    std::vector<double>& values) const;

  std::filesystem::path path_;
  nlohmann::json root_;
  std::vector<std::string> buffers_;
};

/// Numbers in an element of an accessor of this type ("VEC3": 3); 0 for an unknown one.
int64_t type_width(const std::string& type);

}  // namespace freetalk::mesh
