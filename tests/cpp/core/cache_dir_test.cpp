#include "freetalk/core/cache_dir.h"

#include <gtest/gtest.h>
#include <stdlib.h>

#include <map>
#include <optional>
#include <string>

namespace freetalk::core {
namespace {

/// Environment variables for a test, then as they were.
class Environment : public testing::Test {
 protected:
  void SetUp() override {
    for (const char* name : {"FREETALK_CACHE", "XDG_CACHE_HOME", "HOME"}) {
      const char* value = getenv(name);
      before_[name] = value ? std::optional<std::string>(value) : std::nullopt;
      unsetenv(name);
    }
  }
  void TearDown() override {
    for (const auto& [name, value] : before_) {
      value ? setenv(name.c_str(), value->c_str(), 1) : unsetenv(name.c_str());
    }
  }

 private:
  std::map<std::string, std::optional<std::string>> before_;
};

TEST_F(Environment, CachesGoToTheFirstFolderThatIsNamed) {
  EXPECT_EQ(default_cache_dir(), std::filesystem::temp_directory_path() / "freetalk");
  setenv("HOME", "/home/someone", 1);
  EXPECT_EQ(default_cache_dir(), "/home/someone/.cache/freetalk");
  setenv("XDG_CACHE_HOME", "/big/disk", 1);
  EXPECT_EQ(default_cache_dir(), "/big/disk/freetalk");
  setenv("FREETALK_CACHE", "/own", 1);
  EXPECT_EQ(default_cache_dir(), "/own");
}

TEST_F(Environment, AnEmptyVariableCountsAsNone) {
  setenv("HOME", "/home/someone", 1);
  setenv("XDG_CACHE_HOME", "", 1);
  setenv("FREETALK_CACHE", "", 1);
  EXPECT_EQ(default_cache_dir(), "/home/someone/.cache/freetalk");
}

}  // namespace
}  // namespace freetalk::core
