#include <pybind11/functional.h>
#include <torch/extension.h>

#include "bind_options.h"
#include "freetalk/core/random.h"
#include "freetalk/diffusion/sampler.h"
#include "freetalk/diffusion/schedule.h"

namespace py = pybind11;
namespace fd = freetalk::diffusion;

namespace {

void bind_schedule(py::module_& m) {
  freetalk::bindings::bind_options<fd::ScheduleOptions>(m, "ScheduleOptions",
                                                        "Noise schedule: kind, num_steps, betas.");
  py::class_<fd::Schedule>(m, "Schedule", "Noise schedule and forward process [FreeTalk Eq. 4-5].")
      .def(py::init<const fd::ScheduleOptions&>(), py::arg("options") = fd::ScheduleOptions{})
      .def("q_sample", &fd::Schedule::q_sample, py::arg("x0"), py::arg("timestep"), py::kw_only(),
           py::arg("noise"), py::call_guard<py::gil_scoped_release>(),
           "Noisy x_l of x0 (B, ...) at timestep (B,) int64 with the given noise [FreeTalk Eq. 5].")
      .def("alpha_bar", &fd::Schedule::alpha_bar, py::arg("timestep"))
      .def_property_readonly("alphas_cumprod", &fd::Schedule::alphas_cumprod)
      .def_property_readonly("options", &fd::Schedule::options);
}

void bind_sampler(py::module_& m) {
  freetalk::bindings::bind_options<fd::SamplerOptions>(
      m, "SamplerOptions", "Reverse process: sampler, num_steps, eta, spacing.");
  m.def("sampler_timesteps", &fd::sampler_timesteps, py::arg("schedule"), py::arg("options"),
        "The timesteps that a sampler visits, falling.");
  m.def(
      "sample",
      [](const fd::Schedule& schedule, const fd::Denoiser& denoiser, const at::Tensor& noise,
         const fd::SamplerOptions& options, uint64_t seed,
         const std::optional<fd::StepCallback>& on_step) {
        return fd::sample(schedule, denoiser, noise, options,
                          freetalk::core::make_generator(seed, noise.device()),
                          on_step.value_or(fd::StepCallback{}));
      },
      py::arg("schedule"), py::arg("denoiser"), py::kw_only(), py::arg("noise"),
      py::arg("options") = fd::SamplerOptions{}, py::arg("seed") = 0,
      py::arg("on_step") = py::none(),
      "Reverse process from noise with denoiser(x, timestep) -> x0; seed: of the noise that "
      "stochastic samplers add.");
}

}  // namespace

void bind_diffusion(py::module_& m) {
  bind_schedule(m);
  bind_sampler(m);
}
