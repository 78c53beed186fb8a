#include "freetalk/stm/stm.h"

#include <torch/extension.h>

#include "bind_module.h"

namespace py = pybind11;
namespace fs = freetalk::stm;

void bind_stm(py::module_& m) {
  freetalk::bindings::bind_options<fs::StmOptions>(m, "StmOptions",
                                                   "Options of STM [FreeTalk 3.2].");
  py::class_<fs::MeshFeatures>(m, "MeshFeatures", "What STM computes of a mesh once.")
      .def_readonly("hidden", &fs::MeshFeatures::hidden)
      .def_readonly("queries", &fs::MeshFeatures::queries);
  const auto release = py::call_guard<py::gil_scoped_release>();
  freetalk::bindings::bind_module_impl<fs::StmImpl, fs::StmOptions>(m, "StmImpl")
      .def("forward", &fs::StmImpl::forward, py::arg("positions"), py::arg("operators"),
           py::arg("landmarks"), release)
      .def("encode", &fs::StmImpl::encode, py::arg("positions"), py::arg("operators"), release)
      .def("decode", &fs::StmImpl::decode, py::arg("mesh"), py::arg("operators"),
           py::arg("landmarks"), release)
      .def("frames_per_chunk", &fs::StmImpl::frames_per_chunk, py::arg("num_vertices"),
           py::arg("memory_bytes"));
}
