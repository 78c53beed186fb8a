#include "freetalk/core/safetensors.h"

#include <ATen/ATen.h>
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstring>
#include <nlohmann/json.hpp>
#include <utility>

#include "core/file.h"
#include "freetalk/core/error.h"

namespace freetalk::core {
namespace {

using Json = nlohmann::ordered_json;
constexpr uint64_t kMaxHeaderBytes = 100'000'000;

const std::vector<std::pair<const char*, at::ScalarType>>& dtype_table() {
  static const std::vector<std::pair<const char*, at::ScalarType>> table = {
      {"F64", at::kDouble}, {"F32", at::kFloat}, {"F16", at::kHalf},  {"BF16", at::kBFloat16},
      {"I64", at::kLong},   {"I32", at::kInt},   {"I16", at::kShort}, {"I8", at::kChar},
      {"U8", at::kByte},    {"BOOL", at::kBool}};
  return table;
}

/// A read-only mapping of a whole file.
class Mapping {
 public:
  explicit Mapping(const std::filesystem::path& path) {
    FREETALK_RUNTIME_CHECK(std::filesystem::exists(path), path.string(), ": no such file");
    const int descriptor = ::open(path.c_str(), O_RDONLY);
    FREETALK_RUNTIME_CHECK(descriptor >= 0, path.string(), ": cannot be opened (",
                           std::strerror(errno), ")");
    struct stat status {};
    ::fstat(descriptor, &status);
    size_ = static_cast<size_t>(status.st_size);
    if (S_ISREG(status.st_mode) && size_ > 0) {
      data_ = ::mmap(nullptr, size_, PROT_READ | PROT_WRITE, MAP_PRIVATE, descriptor, 0);
    }
    ::close(descriptor);
    FREETALK_RUNTIME_CHECK(data_ != MAP_FAILED && data_ != nullptr, path.string(),
                           ": is empty or cannot be mapped; fetch the file again");
  }
  ~Mapping() { ::munmap(data_, size_); }
  Mapping(const Mapping&) = delete;
  Mapping& operator=(const Mapping&) = delete;

  char* data() const { return static_cast<char*>(data_); }
  size_t size() const { return size_; }

 private:
  void* data_ = MAP_FAILED;
  size_t size_ = 0;
};

at::Tensor map_tensor(const Json& entry, const std::shared_ptr<Mapping>& mapping,
                      uint64_t data_start) {
  const auto dtype_name = entry.at("dtype").get<std::string>();
  const auto shape = entry.at("shape").get<std::vector<int64_t>>();
  const auto offsets = entry.at("data_offsets").get<std::vector<uint64_t>>();
  at::ScalarType dtype = at::ScalarType::Undefined;
  for (const auto& [name, type] : dtype_table()) {
    if (dtype_name == name) dtype = type;
  }
  FREETALK_RUNTIME_CHECK(dtype != at::ScalarType::Undefined, "unsupported dtype ", dtype_name);
  uint64_t bytes = c10::elementSize(dtype);
  for (int64_t extent : shape) {
    FREETALK_RUNTIME_CHECK(extent >= 0 && extent <= int64_t{1} << 40, "impossible shape");
    FREETALK_RUNTIME_CHECK(!__builtin_mul_overflow(bytes, static_cast<uint64_t>(extent), &bytes),
                           "impossible shape");
  }
  const uint64_t available = mapping->size() - data_start;
  FREETALK_RUNTIME_CHECK(offsets.size() == 2 && offsets[0] <= offsets[1] &&
                             offsets[1] <= available && offsets[1] - offsets[0] == bytes,
                         "data offsets do not fit the file");
  if (bytes == 0) return at::empty(shape, dtype);
  char* data = mapping->data() + data_start + offsets[0];
  if (reinterpret_cast<uintptr_t>(data) % c10::elementSize(dtype) != 0) {
    at::Tensor copy = at::empty(shape, dtype);
    std::memcpy(copy.data_ptr(), data, bytes);
    return copy;
  }
  return at::from_blob(
      data, shape, [mapping](void*) {}, at::TensorOptions().dtype(dtype));
}

}  // namespace

SafetensorsFile::SafetensorsFile(const std::filesystem::path& path) : path_(path) {
  const auto mapping = std::make_shared<Mapping>(path);
  uint64_t header_bytes = 0;
  if (mapping->size() >= 8) std::memcpy(&header_bytes, mapping->data(), 8);
  FREETALK_RUNTIME_CHECK(
      header_bytes > 0 && header_bytes <= kMaxHeaderBytes && header_bytes + 8 <= mapping->size(),
      path.string(), ": is not a safetensors file, or is truncated; fetch it again");
  const Json header =
      Json::parse(mapping->data() + 8, mapping->data() + 8 + header_bytes, nullptr, false);
  FREETALK_RUNTIME_CHECK(header.is_object(), path.string(),
                         ": its safetensors header is broken; fetch it again");
  for (const auto& [name, entry] : header.items()) {
    try {
      if (name == "__metadata__") {
        metadata_ = entry.get<Metadata>();
      } else {
        tensors_[name] = map_tensor(entry, mapping, 8 + header_bytes);
      }
    } catch (const std::exception& error) {
      throw std::runtime_error(
          join(path.string(), ": tensor '", name, "': ", error.what(), "; fetch the file again"));
    }
  }
}

std::vector<std::string> SafetensorsFile::keys() const {
  std::vector<std::string> result;
  for (const auto& item : tensors_) result.push_back(item.first);
  return result;
}

at::Tensor SafetensorsFile::tensor(const std::string& key) const {
  const auto found = tensors_.find(key);
  FREETALK_RUNTIME_CHECK(found != tensors_.end(), path_.string(), ": has no tensor '", key, "'");
  return found->second;
}

TensorMap load_safetensors(const std::filesystem::path& path) {
  const SafetensorsFile file(path);
  TensorMap result;
  for (const std::string& key : file.keys()) result[key] = file.tensor(key);
  return result;
}

void save_safetensors(const std::filesystem::path& path, const TensorMap& tensors,
                      const Metadata& metadata) {
  Json header = Json::object();
  if (!metadata.empty()) header["__metadata__"] = metadata;
  uint64_t offset = 0;
  for (const auto& [name, tensor] : tensors) {
    const char* dtype_name = nullptr;
    for (const auto& [text, type] : dtype_table()) {
      if (tensor.scalar_type() == type) dtype_name = text;
    }
    FREETALK_CHECK(dtype_name != nullptr, path.string(), ": tensor '", name,
                   "' has a dtype safetensors cannot hold");
    const uint64_t bytes = static_cast<uint64_t>(tensor.numel()) * tensor.element_size();
    header[name] = {{"dtype", dtype_name},
                    {"shape", tensor.sizes().vec()},
                    {"data_offsets", {offset, offset + bytes}}};
    offset += bytes;
  }
  std::string text = header.dump();
  text.resize((text.size() + 7) / 8 * 8, ' ');
  write_file_atomic(path, [&](std::ostream& stream) {
    const uint64_t header_bytes = text.size();
    stream.write(reinterpret_cast<const char*>(&header_bytes), 8);
    stream.write(text.data(), static_cast<std::streamsize>(text.size()));
    for (const auto& item : tensors) {
      const at::Tensor flat = item.second.detach().cpu().contiguous();
      stream.write(static_cast<const char*>(flat.const_data_ptr()),
                   static_cast<std::streamsize>(flat.nbytes()));
    }
  });
}

}  // namespace freetalk::core
