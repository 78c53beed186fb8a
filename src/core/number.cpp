#include "core/number.h"

#include <locale.h>
#include <cstdlib>
#include <string>

namespace freetalk::core {

std::from_chars_result parse_number(const char* first, const char* last, double& value) {
  auto result = std::from_chars(first, last, value);
  if (result.ec == std::errc::result_out_of_range) {
    static const locale_t classic = ::newlocale(LC_ALL_MASK, "C", nullptr);
    value = ::strtod_l(std::string(first, result.ptr).c_str(), nullptr, classic);
    result.ec = std::errc();
  }
  return result;
}

}  // namespace freetalk::core
