#include "freetalk/facetalk/facetalk.h"

#include <pybind11/functional.h>
#include <torch/extension.h>

#include "bind_module.h"
#include "freetalk/facetalk/generate.h"

namespace py = pybind11;
namespace ff = freetalk::facetalk;

namespace {

void bind_facetalk_denoiser(py::module_& m) {
  freetalk::bindings::bind_options<ff::FaceTalkOptions>(
      m, "FaceTalkOptions", "Options of the FaceTalk denoiser [FaceTalk Sec. 4].");
  freetalk::bindings::bind_module_impl<ff::FaceTalkImpl, ff::FaceTalkOptions>(m, "FaceTalkImpl")
      .def(
          "forward",
          [](ff::FaceTalkImpl& self, const at::Tensor& x, const at::Tensor& timestep,
             const at::Tensor& audio, const std::optional<at::Tensor>& drop_audio,
             const std::optional<at::Tensor>& valid) {
            const py::gil_scoped_release release;
            return self.forward(
                x, timestep,
                {audio, drop_audio.value_or(at::Tensor()), valid.value_or(at::Tensor())});
          },
          py::arg("x"), py::arg("timestep"), py::kw_only(), py::arg("audio"),
          py::arg("drop_audio") = py::none(), py::arg("valid") = py::none())
      .def("normalize", &ff::FaceTalkImpl::normalize, py::arg("codes"))
      .def("denormalize", &ff::FaceTalkImpl::denormalize, py::arg("codes"))
      .def("set_code_statistics", &ff::FaceTalkImpl::set_code_statistics, py::kw_only(),
           py::arg("mean"), py::arg("scale"), py::arg("rest"), py::arg("landmark_basis"))
      .def("landmarks", &ff::FaceTalkImpl::landmarks, py::arg("codes"));
}

void bind_codes(py::module_& m) {
  freetalk::bindings::bind_options<ff::GenerateOptions>(m, "GenerateOptions",
                                                        "Sampling of expression codes.");
  m.def(
      "generate",
      [](const std::shared_ptr<ff::FaceTalkImpl>& model, const at::Tensor& features,
         const ff::GenerateOptions& options, const std::vector<uint64_t>& seeds,
         const std::optional<freetalk::diffusion::StepCallback>& on_step) {
        const py::gil_scoped_release release;
        ff::FaceTalk holder(model);
        return ff::generate(holder, features, options, seeds,
                            on_step.value_or(freetalk::diffusion::StepCallback{}));
      },
      py::arg("model"), py::arg("features"), py::kw_only(),
      py::arg("options") = ff::GenerateOptions{}, py::arg("seeds"),
      py::arg("on_step") = py::none());
  py::class_<ff::CodeStream>(m, "CodeStream", "Codes while the speech is being heard.")
      .def(py::init([](const std::shared_ptr<ff::FaceTalkImpl>& model,
                       const std::vector<uint64_t>& seeds, const ff::GenerateOptions& options) {
             return std::make_unique<ff::CodeStream>(ff::FaceTalk(model), seeds, options);
           }),
           py::arg("model"), py::kw_only(), py::arg("seeds"),
           py::arg("options") = ff::GenerateOptions{})
      .def(
          "push",
          [](ff::CodeStream& self, const at::Tensor& features) { return self.push(features); },
          py::arg("features"), py::call_guard<py::gil_scoped_release>())
      .def("reset", &ff::CodeStream::reset)
      .def("num_held", &ff::CodeStream::num_held);
}

}  // namespace

void bind_facetalk(py::module_& m) {
  bind_facetalk_denoiser(m);
  bind_codes(m);
}
