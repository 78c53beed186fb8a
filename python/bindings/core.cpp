#include "freetalk/core/safetensors.h"

#include <pybind11/functional.h>
#include <pybind11/stl/filesystem.h>
#include <torch/extension.h>

#include "freetalk/core/cache_dir.h"
#include "freetalk/core/conventions.h"
#include "freetalk/core/log.h"
#include "freetalk/core/module_io.h"
#include "freetalk/core/options.h"

namespace py = pybind11;

void bind_core(py::module_& m) {
  m.def("default_cache_dir", &freetalk::core::default_cache_dir,
        "The folder of the disk caches: $FREETALK_CACHE, or $XDG_CACHE_HOME/freetalk, or "
        "~/.cache/freetalk.");
  m.def("load_safetensors", &freetalk::core::load_safetensors, py::arg("path"),
        py::call_guard<py::gil_scoped_release>(),
        "Tensors of a safetensors file by name, memory-mapped.");
  m.def("save_safetensors", &freetalk::core::save_safetensors, py::arg("path"), py::arg("tensors"),
        py::arg("metadata") = freetalk::core::Metadata{}, py::call_guard<py::gil_scoped_release>(),
        "Writes tensors by name to a safetensors file, atomically.");
  m.attr("NUM_LANDMARKS") = freetalk::core::kNumLandmarks;
  py::dict units;
  for (const auto& unit : freetalk::core::kUnits) units[unit.name] = unit.metres;
  m.attr("UNITS") = units;
  m.def("save_model_files", &freetalk::core::save_model_files, py::arg("directory"),
        py::arg("config"), py::arg("tensors"), py::call_guard<py::gil_scoped_release>(),
        "Writes model.safetensors and config.json (JSON text), each of which says which save it is "
        "of.");
  m.def("read_model_options", &freetalk::core::read_model_options, py::arg("directory"),
        py::arg("format"), py::call_guard<py::gil_scoped_release>(),
        "The options in config.json of a model's folder, as JSON text.");
  m.def("nearest_name", &freetalk::core::nearest_name, py::arg("name"), py::arg("known"),
        "The known name with the smallest edit distance.");
  m.def(
      "set_log_sink",
      [](const std::optional<std::function<void(int, const std::string&)>>& sink) {
        using freetalk::core::LogLevel;
        if (!sink) return freetalk::core::set_log_sink({});
        freetalk::core::set_log_sink([call = *sink](LogLevel level, const std::string& text) {
          call(10 * (static_cast<int>(level) + 1), text);
        });
      },
      py::arg("sink"),
      "Hands what the native library has to say to sink(level, text), levels as in logging; None: "
      "warnings to stderr.");
}
