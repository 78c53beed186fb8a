// Binds an options struct from its one list of fields: keyword constructor, attributes, dict, repr,
// pickle.
#pragma once

#include <torch/extension.h>

#include <string>
#include <vector>

#include "freetalk/core/error.h"
#include "freetalk/core/options.h"

namespace freetalk::bindings {

namespace py = pybind11;

inline py::dict options_dict(const std::vector<core::NamedOption>& options) {
  py::dict result;
  for (const auto& option : options) result[py::str(option.name)] = py::cast(option.value);
  return result;
}

/// `values` (a Python mapping) over `options`, with the same checks as JSON.
template <class Options>
void update_options(Options& options, const py::dict& values, const std::string& name) {
  const auto json = py::module_::import("json").attr("dumps")(values).template cast<std::string>();
  core::options_from_json(options, json, name);
}

template <class Options>
py::class_<Options> bind_options(py::module_& m, const char* name, const char* doc) {
  const std::string type_name = name;
  py::class_<Options> type(m, name, doc);
  type.def(py::init([type_name](const py::kwargs& values) {
    Options options;
    update_options(options, values, type_name);
    return options;
  }));
  type.def(
      "to_dict", [](const Options& self) { return options_dict(core::list_options(self)); },
      "All fields by name.");
  type.def_static(
      "from_dict",
      [type_name](const py::dict& values) {
        Options options;
        update_options(options, values, type_name);
        return options;
      },
      "Options from a mapping; an unknown key is a ValueError naming the nearest known one.");
  type.def("__repr__",
           [type_name](const Options& self) { return type_name + core::options_to_json(self); });
  type.def("__eq__", [](const Options& a, const Options& b) {
    return core::options_to_json(a) == core::options_to_json(b);
  });
  type.def(
      py::pickle([](const Options& self) { return py::make_tuple(core::options_to_json(self)); },
                 [type_name](const py::tuple& state) {
                   Options options;
                   core::options_from_json(options, state[0].cast<std::string>(), type_name);
                   return options;
                 }));
  const auto fields = core::list_options(Options{});
  for (size_t index = 0; index < fields.size(); ++index) {
    const std::string field = fields[index].name;
    type.def_property(
        field.c_str(),
        [index](const Options& self) { return py::cast(core::list_options(self)[index].value); },
        [field, type_name](Options& self, const py::object& value) {
          Options changed = self;
          py::dict values;
          values[py::str(field)] = value;
          update_options(changed, values, type_name);
          self = changed;
        });
  }
  return type;
}

}  // namespace freetalk::bindings
