// Safetensors files: memory-mapped reading, atomic writing.
// Format: 8-byte little-endian header length, JSON header {name: {dtype, shape, data_offsets}}, raw
// data.
#pragma once

#include <ATen/core/Tensor.h>

#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

namespace freetalk::core {

using TensorMap = std::map<std::string, at::Tensor>;
using Metadata = std::map<std::string, std::string>;

/// A safetensors file, mapped into memory; its tensors share the mapping and keep it alive.
class SafetensorsFile {
 public:
  /// @throws std::runtime_error naming the file when it is missing, truncated or not safetensors.
  explicit SafetensorsFile(const std::filesystem::path& path);

  std::vector<std::string> keys() const;
  bool contains(const std::string& key) const { return tensors_.count(key) != 0; }
  /// The tensor `key`, not copied (do not write to it). @throws std::runtime_error naming file and
  /// key.
  at::Tensor tensor(const std::string& key) const;
  const Metadata& metadata() const { return metadata_; }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
  TensorMap tensors_;
  Metadata metadata_;
};

/// All tensors of a file, not copied.
TensorMap load_safetensors(const std::filesystem::path& path);

/// Writes `tensors` (any device; stored contiguous) atomically.
void save_safetensors(const std::filesystem::path& path, const TensorMap& tensors,
                      const Metadata& metadata = {});

}  // namespace freetalk::core
