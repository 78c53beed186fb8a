#include <torch/extension.h>

#include "bind_module.h"
#include "freetalk/nn/diffusion_net.h"
#include "freetalk/nn/embedding.h"
#include "freetalk/nn/landmark_graph.h"
#include "freetalk/nn/sparse.h"
#include "freetalk/nn/transformer.h"

namespace py = pybind11;
namespace fn = freetalk::nn;

void bind_nn(py::module_& m) {
  const auto release = py::call_guard<py::gil_scoped_release>();
  freetalk::bindings::bind_options<fn::DiffusionNetOptions>(m, "DiffusionNetOptions",
                                                            "Options of DiffusionNet.");
  freetalk::bindings::bind_module_impl<fn::DiffusionNetImpl, fn::DiffusionNetOptions>(
      m, "DiffusionNetImpl")
      .def("forward", &fn::DiffusionNetImpl::forward, py::arg("x"), py::arg("operators"), release);
  m.def("sinusoidal_code", &fn::sinusoidal_code, py::arg("positions"), py::arg("dim"), release);
  m.def("sparse_product", &fn::sparse_product, py::arg("matrix"), py::arg("transposed"),
        py::arg("x"), release);
  m.def(
      "band_mask",
      [](int64_t num_frames, int64_t radius) {
        return fn::band_mask(num_frames, radius, c10::kCPU);
      },
      py::arg("num_frames"), py::arg("radius"));
  m.def("landmark_edges", &fn::landmark_edges);
  m.def("landmark_mirror", &fn::landmark_mirror);
  m.def("landmark_adjacency", &fn::landmark_adjacency);
}
