#include <pybind11/numpy.h>
#include <pybind11/stl/filesystem.h>
#include <torch/extension.h>

#include "freetalk/audio/audio.h"
#include "freetalk/core/error.h"

namespace py = pybind11;
namespace audio = freetalk::audio;

namespace {

using Release = py::call_guard<py::gil_scoped_release>;

audio::Audio audio_from_array(const py::array& samples, int64_t sample_rate_hz) {
  FREETALK_CHECK(samples.ndim() == 1, "samples have ", samples.ndim(),
                 " dimensions: expected (S,), one channel (average the channels first)");
  FREETALK_CHECK(
      samples.dtype().kind() == 'f',
      "samples are not floating point: divide integers by their full scale, e.g. int16 by 32768");
  const auto floats = py::array_t<float, py::array::c_style | py::array::forcecast>(samples);
  audio::Audio result{{floats.data(), floats.data() + floats.size()}, sample_rate_hz};
  result.check();
  return result;
}

py::array samples_view(const py::object& self) {
  const auto& samples = self.cast<const audio::Audio&>().samples;
  py::array_t<float> view(static_cast<py::ssize_t>(samples.size()), samples.data(), self);
  view.attr("flags").attr("writeable") = false;
  return view;
}

}  // namespace

void bind_audio(py::module_& m) {
  py::class_<audio::Audio>(m, "Audio", "Mono sound: float32 samples and their rate.")
      .def(py::init(&audio_from_array), py::arg("samples"), py::arg("sample_rate_hz") = 16000)
      .def_property_readonly("samples", &samples_view, "(S,) float32, read-only view")
      .def_readonly("sample_rate_hz", &audio::Audio::sample_rate_hz)
      .def_property_readonly("duration_s", &audio::Audio::duration_s)
      .def("__len__", [](const audio::Audio& self) { return self.samples.size(); })
      .def("__repr__",
           [](const audio::Audio& self) {
             return freetalk::core::join("Audio(", self.duration_s(), " s at ", self.sample_rate_hz,
                                         " Hz)");
           })
      .def(py::pickle(
          [](const py::object& self) {
            const py::object samples = samples_view(self).attr("copy")();
            return py::make_tuple(samples, self.cast<const audio::Audio&>().sample_rate_hz);
          },
          [](const py::tuple& state) {
            return audio_from_array(state[0].cast<py::array>(), state[1].cast<int64_t>());
          }));
  m.attr("MIN_SAMPLE_RATE_HZ") = audio::kMinSampleRateHz;
  m.attr("MAX_SAMPLE_RATE_HZ") = audio::kMaxSampleRateHz;
  m.def("load_audio", &audio::load_audio, py::arg("path"), py::arg("sample_rate_hz") = 16000,
        Release());
  m.def("resample", &audio::resample, py::arg("audio"), py::arg("sample_rate_hz"), Release());
  m.def("save_wav", &audio::save_wav, py::arg("path"), py::arg("audio"), py::kw_only(),
        py::arg("bits_per_sample") = 16, Release());
}
