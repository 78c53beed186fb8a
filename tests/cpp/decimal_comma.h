// A locale with a decimal comma for one test, in which C's strtod takes "0.5" for 0.
#pragma once

#include <gtest/gtest.h>

#include <clocale>
#include <cstdlib>
#include <filesystem>
#include <string>

namespace freetalk::testing {

class DecimalComma {
 public:
  DecimalComma() {
    constexpr const char* kName = "de_DE.UTF-8";
    is_set_ = std::setlocale(LC_NUMERIC, kName) != nullptr;
    if (is_set_) return;
    // Not installed: glibc makes it from its sources, where those are.
    const std::filesystem::path folder =
        std::filesystem::path(::testing::TempDir()) / "freetalk_locale";
    std::filesystem::create_directories(folder);
    const std::string make =
        "localedef -i de_DE -f UTF-8 '" + (folder / kName).string() + "' >/dev/null 2>&1";
    if (std::system(make.c_str()) != 0) return;
    ::setenv("LOCPATH", folder.c_str(), 1);
    is_set_ = std::setlocale(LC_NUMERIC, kName) != nullptr;
    ::unsetenv("LOCPATH");
  }
  ~DecimalComma() { std::setlocale(LC_NUMERIC, "C"); }
  DecimalComma(const DecimalComma&) = delete;
  DecimalComma& operator=(const DecimalComma&) = delete;

  /// Whether this machine has such a locale.
  bool is_set() const { return is_set_ && std::strtod("0,5", nullptr) == 0.5; }

 private:
  bool is_set_ = false;
};

}  // namespace freetalk::testing
