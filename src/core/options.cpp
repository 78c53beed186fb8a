#include "freetalk/core/options.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <numeric>

#include "freetalk/core/error.h"

namespace freetalk::core {
namespace {

using Json = nlohmann::ordered_json;

size_t edit_distance(const std::string& a, const std::string& b) {
  std::vector<size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), size_t{0});
  for (size_t i = 1; i <= a.size(); ++i) {
    size_t diagonal = row[0];
    row[0] = i;
    for (size_t j = 1; j <= b.size(); ++j) {
      const size_t substitution = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, substitution});
    }
  }
  return row[b.size()];
}

template <class T>
struct Optional : std::false_type {};
template <class T>
struct Optional<std::optional<T>> : std::true_type {};

template <class T>
std::string type_name() {
  if constexpr (Optional<T>::value) return type_name<typename T::value_type>() + " or null";
  if constexpr (std::is_same_v<T, bool>) return "true or false";
  if constexpr (std::is_same_v<T, int64_t>) return "an integer";
  if constexpr (std::is_same_v<T, double>) return "a number";
  if constexpr (std::is_same_v<T, std::string>) return "a string";
  if constexpr (std::is_same_v<T, std::vector<int64_t>>) return "a list of integers";
  if constexpr (std::is_same_v<T, std::vector<double>>) return "a list of numbers";
  return "a list of strings";
}

template <class T>
bool holds(const Json& value) {
  if constexpr (Optional<T>::value) return value.is_null() || holds<typename T::value_type>(value);
  if constexpr (std::is_same_v<T, bool>) return value.is_boolean();
  if constexpr (std::is_same_v<T, int64_t>) return value.is_number_integer();
  if constexpr (std::is_same_v<T, double>) return value.is_number();
  if constexpr (std::is_same_v<T, std::string>) return value.is_string();
  if constexpr (std::is_same_v<T, std::vector<int64_t>>) {
    return value.is_array() && std::all_of(value.begin(), value.end(),
                                           [](const Json& v) { return v.is_number_integer(); });
  }
  if constexpr (std::is_same_v<T, std::vector<double>>) {
    return value.is_array() &&
           std::all_of(value.begin(), value.end(), [](const Json& v) { return v.is_number(); });
  }
  return value.is_array() &&
         std::all_of(value.begin(), value.end(), [](const Json& v) { return v.is_string(); });
}

}  // namespace

std::string options_to_json_text(const std::vector<NamedOption>& options, bool pretty) {
  Json object = Json::object();
  for (const NamedOption& option : options) {
    std::visit(
        [&](const auto& value) {
          Json& slot = object[option.name];
          if constexpr (Optional<std::decay_t<decltype(value)>>::value) {
            slot = value ? Json(*value) : Json();
          } else {
            slot = value;
          }
        },
        option.value);
  }
  return pretty ? object.dump(2) : object.dump();
}

std::vector<NamedOption> options_from_json_text(const std::vector<NamedOption>& defaults,
                                                const std::string& json, const std::string& where) {
  const Json object = Json::parse(json, nullptr, /*allow_exceptions=*/false);
  FREETALK_CHECK(object.is_object(), where, ": the options are not a JSON object");
  std::vector<std::string> known;
  for (const NamedOption& option : defaults) known.push_back(option.name);
  std::vector<NamedOption> result = defaults;
  for (const auto& [key, value] : object.items()) {
    const auto found = std::find(known.begin(), known.end(), key);
    FREETALK_CHECK(found != known.end(), where, ": unknown option '", key, "'; did you mean '",
                   nearest_name(key, known), "'?");
    OptionValue& slot = result[static_cast<size_t>(found - known.begin())].value;
    std::visit(
        [&, &json_value = value, &name = key](auto& current) {
          using T = std::decay_t<decltype(current)>;
          FREETALK_CHECK(holds<T>(json_value), where, ": option '", name, "' must be ",
                         type_name<T>(), ", found ", json_value.dump());
          if constexpr (!Optional<T>::value) {
            current = json_value.template get<T>();
          } else if (json_value.is_null()) {
            current = std::nullopt;
          } else {
            current = json_value.template get<typename T::value_type>();
          }
        },
        slot);
  }
  return result;
}

std::string nearest_name(const std::string& name, const std::vector<std::string>& known) {
  if (known.empty()) return "";
  return *std::min_element(known.begin(), known.end(),
                           [&](const std::string& a, const std::string& b) {
                             return edit_distance(name, a) < edit_distance(name, b);
                           });
}

}  // namespace freetalk::core
