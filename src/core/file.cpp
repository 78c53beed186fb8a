#include "freetalk/core/file.h"

#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <sstream>

#include "freetalk/core/error.h"

namespace freetalk::core {

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

void write_file_atomic(const std::filesystem::path& path,
                       const std::function<void(std::ostream&)>& write) {
  static std::atomic<unsigned> counter{0};
  std::error_code error;
  if (path.has_parent_path()) std::filesystem::create_directories(path.parent_path(), error);
  FREETALK_RUNTIME_CHECK(!error, path.string(), ": its folder cannot be made (", error.message(),
                         ")");
  std::filesystem::path temporary = path;
  temporary += join(".tmp-", getpid(), "-", counter++);
  std::ofstream stream(temporary, std::ios::binary | std::ios::trunc);
  FREETALK_RUNTIME_CHECK(stream, path.string(), ": cannot be written (", std::strerror(errno), ")");
  try {
    write(stream);
    stream.close();
    FREETALK_RUNTIME_CHECK(stream, path.string(), ": writing failed (", std::strerror(errno), ")");
    std::filesystem::rename(temporary, path, error);
    FREETALK_RUNTIME_CHECK(!error, path.string(), ": cannot be written (", error.message(), ")");
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
