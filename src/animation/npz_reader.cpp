#include <algorithm>
#include <charconv>
#include <cstring>
#include <optional>
#include <string_view>

#include "freetalk/core/error.h"
#include "npz.h"

namespace freetalk::animation {
namespace {

uint64_t number(const std::string& bytes, size_t at, size_t count) {
  uint64_t value = 0;
  for (size_t i = 0; i < count; ++i) {
    value |= static_cast<uint64_t>(static_cast<unsigned char>(bytes.at(at + i))) << (8 * i);
  }
  return value;
}

/// The text between `'key': ` and the next delimiter in the dictionary of a .npy header.
std::string header_value(const std::string& header, const std::string& key,
                         const std::string& end) {
  const auto start = header.find("'" + key + "':");
  if (start == std::string::npos) return "";
  const auto from = header.find_first_not_of(" ", start + key.size() + 3);
  const auto to = header.find_first_of(end, from + 1);
  return to == std::string::npos ? "" : header.substr(from, to - from);
}

/// The whole number at the start of `text`, if an int64 holds it.
std::optional<int64_t> parse_whole(std::string_view text) {
  int64_t value = 0;
  const auto result = std::from_chars(text.data(), text.data() + text.size(), value);
  return result.ec == std::errc() ? std::optional(value) : std::nullopt;
}

template <class From, class T>
std::vector<T> converted(const std::string& bytes) {
  std::vector<T> result(bytes.size() / sizeof(From));
  for (size_t i = 0; i < result.size(); ++i) {
    From value;
    std::memcpy(&value, bytes.data() + i * sizeof(From), sizeof(From));
    result[i] = static_cast<T>(value);
  }
  return result;
}

void append_utf8(std::string& text, uint32_t point) {
  if (point < 0x80) {
    text += static_cast<char>(point);
    return;
  }
  const int more = point < 0x800 ? 1 : point < 0x10000 ? 2 : 3;
  const uint32_t lead = more == 1 ? 0xC0 : more == 2 ? 0xE0 : 0xF0;
  text += static_cast<char>(lead | (point >> (6 * more)));
  for (int k = more - 1; k >= 0; --k) {
    text += static_cast<char>(0x80 | ((point >> (6 * k)) & 0x3F));
  }
}

}  // namespace

NpzReader::NpzReader(const std::filesystem::path& path)
    : path_(path), file_(path, std::ios::binary) {
  FREETALK_RUNTIME_CHECK(file_, path.string(),
                         ": cannot be opened; give a .npz that freetalk wrote");
  try {
    read_directory();
  } catch (const std::out_of_range&) {
    FREETALK_RUNTIME_CHECK(false, path.string(), ": is truncated or not a .npz file");
  }
}

std::string NpzReader::bytes_at(uint64_t offset, uint64_t count) {
  FREETALK_RUNTIME_CHECK(offset <= file_bytes_ && count <= file_bytes_ - offset, path_.string(),
                         ": is truncated or not a .npz file");
  std::string bytes(count, '\0');
  file_.clear();
  file_.seekg(static_cast<std::streamoff>(offset));
  file_.read(bytes.data(), static_cast<std::streamsize>(count));
  FREETALK_RUNTIME_CHECK(file_, path_.string(), ": is truncated or not a .npz file");
  return bytes;
}

void NpzReader::read_directory() {
  file_.seekg(0, std::ios::end);
  file_bytes_ = static_cast<uint64_t>(std::max<std::streamoff>(0, file_.tellg()));
  const uint64_t tail_bytes = std::min<uint64_t>(file_bytes_, 65557 + 20);
  const std::string tail = bytes_at(file_bytes_ - tail_bytes, tail_bytes);
  const auto end = tail.rfind(std::string("PK\x05\x06", 4));
  FREETALK_RUNTIME_CHECK(end != std::string::npos, path_.string(),
                         ": is truncated or not a .npz file");
  uint64_t count = number(tail, end + 10, 2), position = number(tail, end + 16, 4);
  if (end >= 20 && tail.compare(end - 20, 4, std::string("PK\x06\x07", 4)) == 0) {
    const std::string end64 = bytes_at(number(tail, end - 12, 8), 56);
    count = number(end64, 32, 8);
    position = number(end64, 48, 8);
  }
  for (uint64_t i = 0; i < count; ++i) {
    const std::string record = bytes_at(position, 46);
    const uint64_t name_bytes = number(record, 28, 2), extra_bytes = number(record, 30, 2);
    const std::string text = bytes_at(position + 46, name_bytes + extra_bytes);
    std::string name = text.substr(0, name_bytes);
    const std::string extra = text.substr(name_bytes);
    FREETALK_RUNTIME_CHECK(number(record, 10, 2) == 0, path_.string(), ": entry ", name,
                           " is compressed; write it with numpy.savez, not savez_compressed");
    uint64_t bytes = number(record, 24, 4), offset = number(record, 42, 4);
    for (size_t at = 0; at + 4 <= extra.size(); at += 4 + number(extra, at + 2, 2)) {
      if (number(extra, at, 2) != 1) continue;
      size_t field = at + 4;
      if (bytes == 0xFFFFFFFFu) bytes = number(extra, field, 8), field += 8;
      if (number(record, 20, 4) == 0xFFFFFFFFu) field += 8;
      if (offset == 0xFFFFFFFFu) offset = number(extra, field, 8);
    }
    position += 46 + name_bytes + extra_bytes + number(record, 32, 2);
    if (name.size() > 4 && name.ends_with(".npy")) {
      arrays_[name.substr(0, name.size() - 4)] = read_header(offset, bytes);
    }
  }
}

NpzArray NpzReader::read_header(uint64_t entry_offset, uint64_t entry_bytes) {
  const std::string local = bytes_at(entry_offset, 30);
  const uint64_t start = entry_offset + 30 + number(local, 26, 2) + number(local, 28, 2);
  const std::string magic = bytes_at(start, 12);
  FREETALK_RUNTIME_CHECK(magic.compare(0, 6, "\x93NUMPY") == 0, path_.string(),
                         ": holds an entry that is not a NumPy array");
  const uint64_t length_bytes = magic[6] == 1 ? 2 : 4;
  const uint64_t header_bytes = number(magic, 8, length_bytes);
  const std::string header = bytes_at(start + 8 + length_bytes, header_bytes);
  NpzArray array;
  array.descr = header_value(header, "descr", ",");
  std::erase(array.descr, '\'');
  array.fortran_order = header_value(header, "fortran_order", ",") == "True";
  const std::string shape = header_value(header, "shape", ")");
  for (size_t at = 0; (at = shape.find_first_of("0123456789", at)) != std::string::npos;) {
    const auto extent = parse_whole(std::string_view(shape).substr(at));
    FREETALK_RUNTIME_CHECK(extent, path_.string(), ": holds a broken NumPy array");
    array.shape.push_back(*extent);
    at = std::min(shape.find_first_not_of("0123456789", at), shape.size());
  }
  array.offset = start + 8 + length_bytes + header_bytes;
  const uint64_t entry_end = std::min(start + entry_bytes, file_bytes_);
  FREETALK_RUNTIME_CHECK(array.offset <= entry_end, path_.string(), ": holds a broken NumPy array");
  measure(array, entry_end - array.offset);
  return array;
}

/// Sets the number and size of the items. A header may claim anything: it is compared with the
/// `available` bytes before anyone makes room for it.
void NpzReader::measure(NpzArray& array, uint64_t available) const {
  const auto digits = array.descr.find_first_of("0123456789");
  const auto size = digits == std::string::npos
                        ? std::nullopt
                        : parse_whole(std::string_view(array.descr).substr(digits));
  const bool text = array.descr.find('U') != std::string::npos;  // 4 bytes a character
  int64_t bytes = 0;
  bool fits = !__builtin_mul_overflow(size.value_or(0), text ? 4 : 1, &bytes);
  array.item_bytes = static_cast<uint64_t>(bytes);
  array.count = 1;
  for (const int64_t extent : array.shape) {
    fits = fits && !__builtin_mul_overflow(array.count, extent, &array.count) &&
           !__builtin_mul_overflow(bytes, extent, &bytes);
  }
  FREETALK_RUNTIME_CHECK(fits && static_cast<uint64_t>(bytes) <= available, path_.string(),
                         ": is truncated, or an array in it claims more than the file holds");
}

const NpzArray& NpzReader::at(const std::string& name) const {
  const auto found = arrays_.find(name);
  FREETALK_RUNTIME_CHECK(found != arrays_.end(), path_.string(), ": has no array '", name,
                         "'; it is not an animation that freetalk wrote");
  FREETALK_RUNTIME_CHECK(!found->second.fortran_order || found->second.shape.size() < 2,
                         path_.string(), ": array '", name, "' must be in C order");
  return found->second;
}

template <class T>
std::vector<T> NpzReader::read(const std::string& name) {
  const NpzArray& array = at(name);
  const bool narrow = array.descr == "<f4" || array.descr == "<i4";
  FREETALK_RUNTIME_CHECK(narrow || array.descr == "<f8" || array.descr == "<i8", path_.string(),
                         ": array '", name, "' has type ", array.descr,
                         "; expected float32, float64, int32 or int64");
  const std::string bytes = bytes_at(array.offset, array.count * array.item_bytes);
  if (array.descr == "<f4") return converted<float, T>(bytes);
  if (array.descr == "<i4") return converted<int32_t, T>(bytes);
  return array.descr == "<f8" ? converted<double, T>(bytes) : converted<int64_t, T>(bytes);
}

template std::vector<double> NpzReader::read(const std::string&);
template std::vector<float> NpzReader::read(const std::string&);
template std::vector<int> NpzReader::read(const std::string&);
template std::vector<int64_t> NpzReader::read(const std::string&);

void NpzReader::read_raw(const std::string& name, const std::string& descr, void* target) {
  const NpzArray& array = at(name);
  FREETALK_RUNTIME_CHECK(array.descr == descr, path_.string(), ": array '", name, "' has type ",
                         array.descr, "; expected ", descr);
  file_.clear();
  file_.seekg(static_cast<std::streamoff>(array.offset));
  file_.read(static_cast<char*>(target),
             static_cast<std::streamsize>(array.count * array.item_bytes));
  FREETALK_RUNTIME_CHECK(file_, path_.string(), ": is truncated");
}

std::string NpzReader::read_text(const std::string& name) {
  const NpzArray& array = at(name);
  FREETALK_RUNTIME_CHECK(array.descr.starts_with("<U"), path_.string(), ": array '", name,
                         "' has type ", array.descr, "; expected text");
  const std::string bytes = bytes_at(array.offset, array.count * array.item_bytes);
  std::string text;
  for (size_t i = 0; i + 4 <= bytes.size(); i += 4) {
    const auto point = static_cast<uint32_t>(number(bytes, i, 4));
    if (point != 0) append_utf8(text, point);
  }
  return text;
}

}  // namespace freetalk::animation
