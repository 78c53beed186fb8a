#include "freetalk/ats/ats.h"

#include <torch/extension.h>

#include "bind_module.h"
#include "freetalk/ats/generate.h"
#include "freetalk/core/random.h"

namespace py = pybind11;
namespace fa = freetalk::ats;

namespace {

at::Tensor value_or_undefined(const std::optional<at::Tensor>& tensor) {
  return tensor.value_or(at::Tensor());
}

void bind_denoiser(py::module_& m) {
  freetalk::bindings::bind_options<fa::AtsOptions>(m, "AtsOptions",
                                                   "Options of the ATS denoiser [FreeTalk 3.1].");
  freetalk::bindings::bind_module_impl<fa::AtsImpl, fa::AtsOptions>(m, "AtsImpl")
      .def(
          "forward",
          [](fa::AtsImpl& self, const at::Tensor& x, const at::Tensor& timestep,
             const at::Tensor& audio, const at::Tensor& emotion, const at::Tensor& intensity,
             const std::optional<at::Tensor>& valid, const std::optional<at::Tensor>& drop_audio,
             const std::optional<at::Tensor>& drop_affect) {
            const py::gil_scoped_release release;
            return self.forward(x, timestep,
                                {audio, emotion, intensity, value_or_undefined(valid),
                                 value_or_undefined(drop_audio), value_or_undefined(drop_affect)});
          },
          py::arg("x"), py::arg("timestep"), py::kw_only(), py::arg("audio"), py::arg("emotion"),
          py::arg("intensity"), py::arg("valid") = py::none(), py::arg("drop_audio") = py::none(),
          py::arg("drop_affect") = py::none())
      .def("normalize", &fa::AtsImpl::normalize, py::arg("motion"))
      .def("denormalize", &fa::AtsImpl::denormalize, py::arg("motion"))
      .def("set_motion_statistics", &fa::AtsImpl::set_motion_statistics, py::arg("mean"),
           py::arg("scale"));
}

void bind_generate(py::module_& m) {
  freetalk::bindings::bind_options<fa::GenerateOptions>(m, "GenerateOptions",
                                                        "Sampling of motion from speech.");
  m.def("window_starts", &fa::window_starts, py::arg("num_frames"), py::arg("window"),
        py::arg("overlap"));
  m.def("parse_emotion", &fa::parse_emotion, py::arg("text"), py::arg("emotions"),
        "'happy', an alias, or 'happy:0.7,sad:0.3' to a convex mixture (E,).");
  m.def(
      "generate",
      [](const std::shared_ptr<fa::AtsImpl>& model, const at::Tensor& features,
         const at::Tensor& emotion, double intensity, const fa::GenerateOptions& options,
         uint64_t seed, const std::optional<freetalk::diffusion::StepCallback>& on_step) {
        const py::gil_scoped_release release;
        fa::Ats holder(model);
        return fa::generate(holder, features, emotion, intensity, options,
                            freetalk::core::make_generator(seed, features.device()),
                            on_step.value_or(freetalk::diffusion::StepCallback{}));
      },
      py::arg("model"), py::arg("features"), py::kw_only(), py::arg("emotion"),
      py::arg("intensity"), py::arg("options") = fa::GenerateOptions{}, py::arg("seed") = 0,
      py::arg("on_step") = py::none());
}

}  // namespace

void bind_ats(py::module_& m) {
  bind_denoiser(m);
  bind_generate(m);
}
