#include <algorithm>
#include <array>
#include <cstring>
#include <functional>
#include <numeric>

#include "freetalk/core/error.h"
#include "npz.h"

namespace freetalk::animation {
namespace {

constexpr uint64_t kZip64 = 0xFFFFFFFFu;
constexpr uint64_t kBlockBytes = uint64_t{8} << 20;  // read at once

/// CRC-32 (IEEE 802.3, reflected), eight bytes a step.
class Crc32 {
 public:
  Crc32() {
    for (uint32_t i = 0; i < 256; ++i) {
      uint32_t crc = i;
      for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
      table_[0][i] = crc;
    }
    for (int k = 1; k < 8; ++k) {
      for (uint32_t i = 0; i < 256; ++i) {
        table_[k][i] = (table_[k - 1][i] >> 8) ^ table_[0][table_[k - 1][i] & 0xFF];
      }
    }
  }

  uint32_t update(uint32_t crc, const void* data, uint64_t count) const {
    const auto* p = static_cast<const unsigned char*>(data);
    crc = ~crc;
    for (; count >= 8; count -= 8, p += 8) {
      uint32_t low, high;
      std::memcpy(&low, p, 4);
      std::memcpy(&high, p + 4, 4);
      low ^= crc;
      crc = table_[7][low & 0xFF] ^ table_[6][(low >> 8) & 0xFF] ^ table_[5][(low >> 16) & 0xFF] ^
            table_[4][low >> 24] ^ table_[3][high & 0xFF] ^ table_[2][(high >> 8) & 0xFF] ^
            table_[1][(high >> 16) & 0xFF] ^ table_[0][high >> 24];
    }
    for (; count > 0; --count, ++p) crc = (crc >> 8) ^ table_[0][(crc ^ *p) & 0xFF];
    return ~crc;
  }

 private:
  std::array<std::array<uint32_t, 256>, 8> table_;
};

/// Little-endian bytes of an integer.
template <class T>
std::string le(T value) {
  std::string bytes(sizeof(T), '\0');
  for (size_t i = 0; i < sizeof(T); ++i) {
    bytes[i] = static_cast<char>((static_cast<uint64_t>(value) >> (8 * i)) & 0xFF);
  }
  return bytes;
}

uint32_t clipped(uint64_t value) {
  return value >= kZip64 ? static_cast<uint32_t>(kZip64) : static_cast<uint32_t>(value);
}

std::string npy_header(const std::string& descr, const std::vector<int64_t>& shape) {
  std::string dims;
  for (const int64_t size : shape) dims += std::to_string(size) + (shape.size() == 1 ? "," : ", ");
  if (shape.size() > 1) dims.resize(dims.size() - 2);
  std::string text =
      "{'descr': '" + descr + "', 'fortran_order': False, 'shape': (" + dims + "), }";
  const size_t prefix = 10;  // magic, version, header length
  text.append(63 - (prefix + text.size()) % 64, ' ');
  text += '\n';
  return std::string("\x93NUMPY\x01\x00", 8) + le<uint16_t>(text.size()) + text;
}

uint64_t item_bytes(const std::string& descr) {
  const uint64_t count = std::stoull(descr.substr(2));
  return descr[1] == 'U' ? 4 * count : count;
}

}  // namespace

void NpzWriter::put(const std::string& bytes) {
  out_.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  position_ += bytes.size();
}

void NpzWriter::add(const std::string& name, const std::string& descr,
                    const std::vector<int64_t>& shape, const void* data,
                    const std::function<void()>& was_read) {
  static const Crc32 crc32;
  const std::string header = npy_header(descr, shape);
  const uint64_t count =
      std::accumulate(shape.begin(), shape.end(), uint64_t{1}, std::multiplies<>());
  const uint64_t data_bytes = count * item_bytes(descr);
  const auto in_blocks = [&](const auto& visit) {
    for (uint64_t start = 0; start < data_bytes; start += kBlockBytes) {
      visit(static_cast<const char*>(data) + start, std::min(kBlockBytes, data_bytes - start));
      if (was_read) was_read();
    }
  };
  uint32_t crc = crc32.update(0, header.data(), header.size());
  in_blocks([&](const char* block, uint64_t size) { crc = crc32.update(crc, block, size); });
  Entry entry{name + ".npy", crc, header.size() + data_bytes, position_};
  const bool zip64 = entry.bytes >= kZip64;
  const std::string extra =
      zip64 ? le<uint16_t>(1) + le<uint16_t>(16) + le(entry.bytes) + le(entry.bytes) : "";
  put(le<uint32_t>(0x04034b50) + le<uint16_t>(zip64 ? 45 : 20) + le<uint16_t>(0) + le<uint16_t>(0) +
      le<uint16_t>(0) + le<uint16_t>(0x21) + le(entry.crc) + le(clipped(entry.bytes)) +
      le(clipped(entry.bytes)) + le<uint16_t>(entry.name.size()) + le<uint16_t>(extra.size()) +
      entry.name + extra + header);
  in_blocks([&](const char* block, uint64_t size) {
    out_.write(block, static_cast<std::streamsize>(size));
  });
  position_ += data_bytes;
  entries_.push_back(std::move(entry));
}

void NpzWriter::add_scalar(const std::string& name, double value) { add(name, "<f8", {}, &value); }

void NpzWriter::add_scalar(const std::string& name, int64_t value) { add(name, "<i8", {}, &value); }

void NpzWriter::add_text(const std::string& name, const std::string& text) {
  std::vector<uint32_t> points;
  for (size_t i = 0; i < text.size();) {
    const auto lead = static_cast<unsigned char>(text[i++]);
    const int more = lead >= 0xF0 ? 3 : lead >= 0xE0 ? 2 : lead >= 0xC0 ? 1 : 0;
    uint32_t point = more == 0 ? lead : lead & (0x3Fu >> more);
    for (int k = 0; k < more && i < text.size(); ++k) {
      point = (point << 6) | (static_cast<unsigned char>(text[i++]) & 0x3Fu);
    }
    points.push_back(point);
  }
  if (points.empty()) points.push_back(0);  // NumPy trims trailing zeros: ''
  add(name, "<U" + std::to_string(points.size()), {}, points.data());
}

void NpzWriter::finish() {
  const uint64_t start = position_;
  for (const auto& entry : entries_) {
    std::string extra;
    if (entry.bytes >= kZip64) extra += le(entry.bytes) + le(entry.bytes);
    if (entry.offset >= kZip64) extra += le(entry.offset);
    if (!extra.empty()) extra = le<uint16_t>(1) + le<uint16_t>(extra.size()) + extra;
    put(le<uint32_t>(0x02014b50) + le<uint16_t>(45) + le<uint16_t>(extra.empty() ? 20 : 45) +
        le<uint16_t>(0) + le<uint16_t>(0) + le<uint16_t>(0) + le<uint16_t>(0x21) + le(entry.crc) +
        le(clipped(entry.bytes)) + le(clipped(entry.bytes)) + le<uint16_t>(entry.name.size()) +
        le<uint16_t>(extra.size()) + le<uint16_t>(0) + le<uint16_t>(0) + le<uint16_t>(0) +
        le<uint32_t>(0) + le(clipped(entry.offset)) + entry.name + extra);
  }
  const uint64_t size = position_ - start;
  const uint64_t count = entries_.size();
  if (start >= kZip64) {
    const uint64_t end64 = position_;
    put(le<uint32_t>(0x06064b50) + le<uint64_t>(44) + le<uint16_t>(45) + le<uint16_t>(45) +
        le<uint32_t>(0) + le<uint32_t>(0) + le(count) + le(count) + le(size) + le(start));
    put(le<uint32_t>(0x07064b50) + le<uint32_t>(0) + le(end64) + le<uint32_t>(1));
  }
  put(le<uint32_t>(0x06054b50) + le<uint16_t>(0) + le<uint16_t>(0) + le<uint16_t>(count) +
      le<uint16_t>(count) + le(clipped(size)) + le(clipped(start)) + le<uint16_t>(0));
}

}  // namespace freetalk::animation
