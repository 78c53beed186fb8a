// Options: plain structs with one list of fields, from which JSON, Python and YAML are served.
//
//   struct FooOptions {
//     int64_t width = 128;  // C, channels
//     template <class V> void fields(V& v) { v("width", width); }
//     void check() const;
//   };
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

namespace freetalk::core {

/// Everything an option may hold. Nothing in an optional one (null in JSON and YAML, None in
/// Python) leaves the choice to whoever reads it.
using OptionValue =
    std::variant<bool, int64_t, double, std::string, std::vector<int64_t>, std::vector<double>,
                 std::vector<std::string>, std::optional<int64_t>, std::optional<double>,
                 std::optional<std::string>>;

struct NamedOption {
  std::string name;
  OptionValue value;
};

/// The fields of `options` in their declared order.
template <class Options>
std::vector<NamedOption> list_options(const Options& options) {
  std::vector<NamedOption> result;
  auto visit = [&result](const char* name, auto& field) {
    result.push_back({name, OptionValue(std::in_place_type<std::decay_t<decltype(field)>>, field)});
  };
  const_cast<Options&>(options).fields(visit);
  return result;
}

/// JSON object text of named options (two-space indent when `pretty`).
std::string options_to_json_text(const std::vector<NamedOption>& options, bool pretty);

/// Reads a JSON object over `defaults`; every key must be known and of its default's type.
/// @throws std::invalid_argument naming `where`, the key and the nearest known one.
std::vector<NamedOption> options_from_json_text(const std::vector<NamedOption>& defaults,
                                                const std::string& json, const std::string& where);

/// The name among `known` with the smallest edit distance to `name` ("" if none).
std::string nearest_name(const std::string& name, const std::vector<std::string>& known);

/// Sets the fields of `options` from `values` (same order as list_options).
template <class Options>
void assign_options(Options& options, const std::vector<NamedOption>& values) {
  size_t index = 0;
  auto visit = [&](const char*, auto& field) {
    field = std::get<std::decay_t<decltype(field)>>(values.at(index++).value);
  };
  options.fields(visit);
}

template <class Options>
std::string options_to_json(const Options& options, bool pretty = false) {
  return options_to_json_text(list_options(options), pretty);
}

/// Reads `json` over the current values of `options` and calls `options.check()`.
template <class Options>
void options_from_json(Options& options, const std::string& json, const std::string& where) {
  assign_options(options, options_from_json_text(list_options(options), json, where));
  options.check();
}

}  // namespace freetalk::core
