#include "core/file.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <random>
#include <sstream>

#include "freetalk/core/error.h"

namespace freetalk::core {
namespace {

/// An open file, for its fsync.
class Descriptor {
 public:
  Descriptor(const std::filesystem::path& path, int flags)
      : value_(::open(path.c_str(), flags | O_CLOEXEC, 0666)) {}
  ~Descriptor() {
    if (value_ >= 0) ::close(value_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  bool is_open() const { return value_ >= 0; }
  /// Whether what was written is on the disk; file systems that cannot tell (EINVAL) count as yes.
  bool sync() const { return ::fsync(value_) == 0 || errno == EINVAL || errno == ENOTSUP; }

 private:
  int value_;
};

}  // namespace

std::string read_text(const std::filesystem::path& path) {
  FREETALK_RUNTIME_CHECK(std::filesystem::exists(path), path.string(), ": no such file");
  FREETALK_RUNTIME_CHECK(!std::filesystem::is_directory(path), path.string(),
                         ": is a folder, not a file");
  std::ifstream stream(path, std::ios::binary);
  FREETALK_RUNTIME_CHECK(stream, path.string(), ": cannot be opened (", std::strerror(errno), ")");
  std::ostringstream content;
  content << stream.rdbuf();
  return content.str();
}

std::string lower_extension(const std::filesystem::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return extension.empty() ? extension : extension.substr(1);
}

std::filesystem::path unused_neighbour(const std::filesystem::path& path) {
  constexpr const char* kDigits = "0123456789abcdefghijklmnopqrstuv";
  std::random_device random;
  std::filesystem::path neighbour;
  do {
    std::string ending = ".tmp-";
    for (int i = 0; i < 13; ++i) ending += kDigits[random() % 32];  // 65 bits
    neighbour = path;
    neighbour += ending;
  } while (std::filesystem::exists(std::filesystem::symlink_status(neighbour)));
  return neighbour;
}

void write_file_atomic(const std::filesystem::path& path,
                       const std::function<void(std::ostream&)>& write) {
  std::error_code error;
  if (path.has_parent_path()) std::filesystem::create_directories(path.parent_path(), error);
  FREETALK_RUNTIME_CHECK(!error, path.string(), ": its folder cannot be made (", error.message(),
                         ")");
  const std::filesystem::path temporary = unused_neighbour(path);
  const Descriptor file(temporary, O_CREAT | O_EXCL | O_WRONLY);
  FREETALK_RUNTIME_CHECK(file.is_open(), path.string(), ": cannot be written (",
                         std::strerror(errno), ")");
  std::ofstream stream(temporary, std::ios::binary | std::ios::trunc);
  try {
    write(stream);
    stream.close();
    FREETALK_RUNTIME_CHECK(stream && file.sync(), path.string(), ": writing failed (",
                           std::strerror(errno), ")");
    std::filesystem::rename(temporary, path, error);
    FREETALK_RUNTIME_CHECK(!error, path.string(), ": cannot be written (", error.message(), ")");
    const Descriptor folder(path.has_parent_path() ? path.parent_path() : ".", O_RDONLY);
    if (folder.is_open()) folder.sync();  // The file is whole either way, if under its old name.
  } catch (...) {
    stream.close();
    std::filesystem::remove(temporary, error);
    throw;
  }
}

void write_file_atomic(const std::filesystem::path& path, const std::string& bytes) {
  write_file_atomic(path, [&](std::ostream& stream) {
    stream.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  });
}

}  // namespace freetalk::core
