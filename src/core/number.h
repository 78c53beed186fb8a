// Numbers in text, the same in every locale.
#pragma once

#include <charconv>

namespace freetalk::core {

/// std::from_chars, but a number beyond a double's range is an infinity or a (signed) zero instead
/// of an error. Never reads the locale: under a German one std::strtod takes "0.5" for 0.
std::from_chars_result parse_number(const char* first, const char* last, double& value);

}  // namespace freetalk::core
