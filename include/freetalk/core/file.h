// Whole-file reading and atomic writing.
#pragma once

#include <filesystem>
#include <functional>
#include <ostream>
#include <string>

namespace freetalk::core {

/// The bytes of a file. @throws std::runtime_error naming the file when it is missing or
/// unreadable.
std::string read_text(const std::filesystem::path& path);

/// Calls `write` with a stream into a temporary neighbour, then renames it onto `path`: readers see
/// the old file or the new one, never half of it. Missing parent folders are made.
/// @throws std::runtime_error naming `path` when it can't be written.
void write_file_atomic(const std::filesystem::path& path,
                       const std::function<void(std::ostream&)>& write);

/// As above, with the bytes at hand.
void write_file_atomic(const std::filesystem::path& path, const std::string& bytes);

}  // namespace freetalk::core
