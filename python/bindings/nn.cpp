#include <torch/extension.h>

#include "bind_module.h"
#include "freetalk/nn/diffusion_net.h"
#include "freetalk/nn/embedding.h"
#include "freetalk/nn/jacobian_field.h"
#include "freetalk/nn/mlp.h"
#include "freetalk/nn/poisson.h"
#include "freetalk/nn/poisson_net.h"
#include "freetalk/nn/sparse.h"
#include "freetalk/nn/transformer.h"

namespace py = pybind11;
namespace fn = freetalk::nn;

namespace {

using Release = py::call_guard<py::gil_scoped_release>;

template <class Impl, class Options>
void bind_surface_net(py::module_& m, const std::string& name) {
  freetalk::bindings::bind_options<Options>(m, (name + "Options").c_str(),
                                            ("Options of " + name + ".").c_str());
  freetalk::bindings::bind_module_impl<Impl, Options>(m, (name + "Impl").c_str())
      .def("forward", &Impl::forward, py::arg("x"), py::arg("operators"), Release());
}

void bind_face_functions(py::module_& m) {
  m.def("face_gradients", &fn::face_gradients, py::arg("faces"), py::arg("x"), Release());
  m.def("face_divergence", &fn::face_divergence, py::arg("faces"), py::arg("g"), Release());
  m.def("poisson_solve", &fn::poisson_solve, py::arg("faces"), py::arg("rhs"), py::kw_only(),
        py::arg("regularization") = fn::kPoissonRegularization, Release());
  m.def("integrate_jacobians", &fn::integrate_jacobians, py::arg("faces"), py::arg("jacobians"),
        Release());
}

}  // namespace

void bind_nn(py::module_& m) {
  bind_surface_net<fn::DiffusionNetImpl, fn::DiffusionNetOptions>(m, "DiffusionNet");
  bind_surface_net<fn::PoissonNetImpl, fn::PoissonNetOptions>(m, "PoissonNet");
  bind_surface_net<fn::JacobianFieldImpl, fn::JacobianFieldOptions>(m, "JacobianField");
  bind_surface_net<fn::VertexMlpImpl, fn::VertexMlpOptions>(m, "VertexMlp");
  bind_face_functions(m);
  m.def("sinusoidal_code", &fn::sinusoidal_code, py::arg("positions"), py::arg("dim"), Release());
  m.def("sparse_product", &fn::sparse_product, py::arg("matrix"), py::arg("x"), Release(),
        "(B, R, C) products of a SparseOperator (R, V) with x (B, V, C); differentiable in x.");
  m.def(
      "band_mask",
      [](int64_t num_frames, int64_t radius) {
        return fn::band_mask(num_frames, radius, c10::kCPU);
      },
      py::arg("num_frames"), py::arg("radius"));
}
