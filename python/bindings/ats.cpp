#include "freetalk/ats/ats.h"

#include <pybind11/functional.h>
#include <torch/extension.h>

#include "bind_module.h"
#include "freetalk/ats/generate.h"
#include "freetalk/core/random.h"

namespace py = pybind11;
namespace fa = freetalk::ats;
using freetalk::bindings::value_or_undefined;

namespace {

void bind_denoiser(py::module_& m) {
  freetalk::bindings::bind_options<fa::AtsOptions>(m, "AtsOptions",
                                                   "Options of the ATS denoiser [FreeTalk 3.1].");
  freetalk::bindings::bind_module_impl<fa::AtsImpl, fa::AtsOptions>(m, "AtsImpl")
      .def(
          "forward",
          [](fa::AtsImpl& self, const at::Tensor& x, const at::Tensor& timestep,
             const at::Tensor& audio, const at::Tensor& emotion, const at::Tensor& intensity,
             const std::optional<at::Tensor>& valid, const std::optional<at::Tensor>& drop_audio,
             const std::optional<at::Tensor>& drop_affect,
             const std::optional<at::Tensor>& first_position,
             const std::optional<at::Tensor>& known) {
            const py::gil_scoped_release release;
            return self.forward(x, timestep,
                                {audio, emotion, intensity, value_or_undefined(valid),
                                 value_or_undefined(drop_audio), value_or_undefined(drop_affect),
                                 value_or_undefined(first_position), value_or_undefined(known)});
          },
          py::arg("x"), py::arg("timestep"), py::kw_only(), py::arg("audio"), py::arg("emotion"),
          py::arg("intensity"), py::arg("valid") = py::none(), py::arg("drop_audio") = py::none(),
          py::arg("drop_affect") = py::none(), py::arg("first_position") = py::none(),
          py::arg("known") = py::none())
      .def("normalize", &fa::AtsImpl::normalize, py::arg("motion"))
      .def("denormalize", &fa::AtsImpl::denormalize, py::arg("motion"))
      .def("set_motion_statistics", &fa::AtsImpl::set_motion_statistics, py::arg("mean"),
           py::arg("scale"));
}

void bind_generate(py::module_& m) {
  freetalk::bindings::bind_options<fa::GenerateOptions>(m, "GenerateOptions",
                                                        "Sampling of motion from speech.");
  m.def("articulate", &fa::articulate, py::arg("motion"), py::arg("gain"),
        "(..., 68, 3) displacements, m, with the motion of lips and jaw scaled about the neutral "
        "face; closures stay.",
        py::call_guard<py::gil_scoped_release>());
  m.def("window_starts", &fa::window_starts, py::arg("num_frames"), py::arg("window"),
        py::arg("overlap"));
  m.def(
      "generate",
      [](const std::shared_ptr<fa::AtsImpl>& model, const at::Tensor& features,
         const at::Tensor& emotion, const at::Tensor& intensity,
         const std::optional<at::Tensor>& weight, const fa::GenerateOptions& options,
         const std::vector<uint64_t>& seeds,
         const std::optional<freetalk::diffusion::StepCallback>& on_step) {
        const py::gil_scoped_release release;
        fa::Ats holder(model);
        std::vector<at::Generator> generators;
        for (const uint64_t seed : seeds) {
          generators.push_back(freetalk::core::make_generator(seed, features.device()));
        }
        return fa::generate(holder, features,
                            fa::Affect{emotion, intensity, value_or_undefined(weight)}, options,
                            generators, on_step.value_or(freetalk::diffusion::StepCallback{}));
      },
      py::arg("model"), py::arg("features"), py::kw_only(), py::arg("emotion"),
      py::arg("intensity"), py::arg("weight") = py::none(),
      py::arg("options") = fa::GenerateOptions{}, py::arg("seeds"),
      py::arg("on_step") = py::none());
}

void bind_emotion(py::module_& m) {
  m.def("parse_emotion", &fa::parse_emotion, py::arg("text"), py::arg("emotions"),
        "'happy', an alias, or 'happy:0.7,sad:0.3' to a convex mixture (E,).");
  m.def(
      "emotion_track",
      [](const std::string& text, const std::vector<std::string>& emotions, double intensity,
         int64_t num_frames, double fps) {
        const auto felt =
            fa::interpolate(fa::parse_emotion_keys(text, emotions, intensity), num_frames, fps);
        return std::tuple{felt.emotion, felt.intensity, felt.weight};
      },
      py::arg("text"), py::arg("emotions"), py::kw_only(), py::arg("intensity"),
      py::arg("num_frames"), py::arg("fps"),
      "Keys such as '0=neutral; 2.5=happy:0.7,surprise:0.3@2.5' to their mixtures (K, E) and "
      "intensities (K,), and the weight of each in every frame (T, K).");
}

}  // namespace

void bind_ats(py::module_& m) {
  bind_denoiser(m);
  bind_emotion(m);
  bind_generate(m);
}
