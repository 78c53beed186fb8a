// What a door to be fuzzed provides; driver.cpp has the rest.
#pragma once

#include <filesystem>

namespace freetalk::fuzz {

/// Reads one file as a user's would be. @return whether it was read; false if it was refused with
/// an error of ours. Anything else thrown, a crash, a hang or boundless memory is a finding.
bool open_door(const std::filesystem::path& file);

}  // namespace freetalk::fuzz
