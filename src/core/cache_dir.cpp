#include "freetalk/core/cache_dir.h"

#include <cstdlib>
#include <string>

namespace freetalk::core {
namespace {

std::string variable(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? "" : value;
}

}  // namespace

std::filesystem::path default_cache_dir() {
  namespace fs = std::filesystem;
  if (const std::string own = variable("FREETALK_CACHE"); !own.empty()) {
    return own;
  }
  if (const std::string xdg = variable("XDG_CACHE_HOME"); !xdg.empty()) {
    return fs::path(xdg) / "freetalk";
  }
  const std::string home = variable("HOME");
  return (home.empty() ? fs::temp_directory_path() : fs::path(home) / ".cache") / "freetalk";
}

}  // namespace freetalk::core
