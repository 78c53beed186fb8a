// Binds a module's Impl as a plain class; freetalk._module.NativeModule makes a torch.nn.Module of
// it.
#pragma once

#include <torch/extension.h>

#include <map>
#include <memory>
#include <optional>
#include <string>

#include "bind_options.h"

namespace freetalk::bindings {

inline at::Tensor value_or_undefined(const std::optional<at::Tensor>& tensor) {
  return tensor.value_or(at::Tensor());
}

template <class Impl, class Options>
py::class_<Impl, std::shared_ptr<Impl>> bind_module_impl(py::module_& m, const char* name) {
  py::class_<Impl, std::shared_ptr<Impl>> type(m, name);
  type.def(py::init([](const Options& options) { return std::make_shared<Impl>(options); }),
           py::arg("options"));
  type.def("named_parameters", [](const Impl& self) {
    std::vector<std::pair<std::string, at::Tensor>> result;
    for (const auto& item : self.named_parameters()) result.emplace_back(item.key(), item.value());
    return result;
  });
  type.def("named_buffers", [](const Impl& self) {
    std::vector<std::pair<std::string, at::Tensor>> result;
    for (const auto& item : self.named_buffers()) result.emplace_back(item.key(), item.value());
    return result;
  });
  type.def(
      "train", [](Impl& self, bool mode) { self.train(mode); }, py::arg("mode"));
  type.def_property_readonly("training", [](const Impl& self) { return self.is_training(); });
  type.def_property_readonly("options", [](const Impl& self) { return self.options(); });
  return type;
}

}  // namespace freetalk::bindings
