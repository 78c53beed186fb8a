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

/// The extension in lower case and without its dot ("FACE.GLB": "glb"); empty if there is none.
std::string lower_extension(const std::filesystem::path& path);

/// A name beside `path` that nothing has, for what will be renamed onto it: random, because process
/// numbers repeat in containers that share a folder.
std::filesystem::path unused_neighbour(const std::filesystem::path& path);

/// Calls `write` with a stream into a temporary neighbour, then renames it onto `path`: readers see
/// the old file or the new one, never half of it, after a loss of power too (the data is on the
/// disk before the name is). Missing parent folders are made.
/// @throws std::runtime_error naming `path` when it can't be written.
void write_file_atomic(const std::filesystem::path& path,
                       const std::function<void(std::ostream&)>& write);

/// As above, with the bytes at hand.
void write_file_atomic(const std::filesystem::path& path, const std::string& bytes);

}  // namespace freetalk::core
