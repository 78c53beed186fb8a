// NumPy's .npz: an uncompressed zip of .npy arrays [numpy.lib.format; APPNOTE 6.3.9, zip64 beyond 4
// GiB].
#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <ostream>
#include <string>
#include <vector>

namespace freetalk::animation {

/// Writes arrays straight from where they lie: no copy of the data is held.
class NpzWriter {
 public:
  explicit NpzWriter(std::ostream& out) : out_(out) {}

  /// @param descr NumPy's type, such as "<f4"
  /// @param data product(shape) items, C order @param was_read called after every block of the data
  /// that was read
  void add(const std::string& name, const std::string& descr, const std::vector<int64_t>& shape,
           const void* data, const std::function<void()>& was_read = {});
  void add_scalar(const std::string& name, double value);
  void add_scalar(const std::string& name, int64_t value);
  /// A 0-d unicode array, `str(array)` in Python. @param text UTF-8
  void add_text(const std::string& name, const std::string& text);
  /// Writes the directory of the archive; nothing may follow.
  void finish();

 private:
  struct Entry {
    std::string name;
    uint32_t crc;
    uint64_t bytes, offset;
  };
  std::ostream& out_;
  uint64_t position_ = 0;
  std::vector<Entry> entries_;

  void put(const std::string& bytes);
};

/// One array of an archive, found but not read.
struct NpzArray {
  std::string descr;
  bool fortran_order = false;
  std::vector<int64_t> shape;
  uint64_t offset = 0;      // of the first item in the file
  int64_t count = 0;        // of items
  uint64_t item_bytes = 0;  // count * item_bytes lie in the file
};

/// Reads archives as numpy.savez writes them.
class NpzReader {
 public:
  /// @throws std::runtime_error naming the file when it is missing, truncated, compressed or no
  /// .npz.
  explicit NpzReader(const std::filesystem::path& path);

  bool contains(const std::string& name) const { return arrays_.count(name) != 0; }
  /// @throws std::runtime_error naming the file and the missing key
  const NpzArray& at(const std::string& name) const;

  /// Items converted to T (from f4, f8, i4 or i8), C order.
  template <class T>
  std::vector<T> read(const std::string& name);
  /// Items of an array whose type is exactly `descr`, into `target`.
  void read_raw(const std::string& name, const std::string& descr, void* target);
  std::string read_text(const std::string& name);

 private:
  std::filesystem::path path_;
  std::ifstream file_;
  uint64_t file_bytes_ = 0;
  std::map<std::string, NpzArray> arrays_;

  void read_directory();
  NpzArray read_header(uint64_t entry_offset, uint64_t entry_bytes);
  void measure(NpzArray& array, uint64_t available) const;
  std::string bytes_at(uint64_t offset, uint64_t count);
};

}  // namespace freetalk::animation
