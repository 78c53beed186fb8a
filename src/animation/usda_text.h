// Text of a USD layer: numbers, lists and names as USD spells them.
#pragma once

#include <ATen/ATen.h>

#include <cctype>
#include <charconv>
#include <cstdint>
#include <ostream>
#include <string>
#include <type_traits>

namespace freetalk::animation {

/// Writes numbers and lists, in any locale.
class UsdText {
 public:
  explicit UsdText(std::ostream& out) : out_(out) {}

  template <class T>
  UsdText& operator<<(const T& value) {
    if constexpr (std::is_arithmetic_v<T>) {
      char digits[32];
      const auto end = std::to_chars(digits, digits + sizeof(digits), value).ptr;
      out_.write(digits, end - digits);
    } else {
      out_ << value;
    }
    return *this;
  }

  /// [item(0), item(1), ...]
  template <class Item>
  UsdText& list(int64_t count, const Item& item) {
    *this << "[";
    for (int64_t i = 0; i < count; ++i) {
      if (i > 0) *this << ", ";
      item(i);
    }
    return *this << "]";
  }

  /// Rows of a float32 tensor (N, C) as tuples.
  UsdText& rows(const at::Tensor& values) {
    const auto flat = values.contiguous();
    const float* data = flat.data_ptr<float>();
    const int64_t width = flat.size(1);
    return list(flat.size(0), [&](int64_t i) {
      *this << "(";
      for (int64_t c = 0; c < width; ++c) {
        if (c > 0) *this << ", ";
        *this << data[i * width + c];
      }
      *this << ")";
    });
  }

 private:
  std::ostream& out_;
};

/// Letters, digits and underscores, not beginning with a digit.
inline std::string identifier(std::string name) {
  for (char& c : name) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte >= 128 || std::isalnum(byte) == 0) c = '_';
  }
  if (name.empty() || std::isdigit(static_cast<unsigned char>(name[0])) != 0) name = "_" + name;
  return name;
}

inline std::string quoted(const std::string& text) {
  std::string result = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') result.push_back('\\');
    if (c == '\n') {
      result += "\\n";
    } else {
      result.push_back(c);
    }
  }
  return result + "\"";
}

}  // namespace freetalk::animation
