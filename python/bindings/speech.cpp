#include <pybind11/functional.h>
#include <pybind11/stl/filesystem.h>
#include <torch/extension.h>

#include "bind_module.h"
#include "freetalk/speech/encoder.h"
#include "freetalk/speech/features.h"
#include "freetalk/speech/pretrained.h"
#include "freetalk/speech/stream.h"

namespace py = pybind11;
namespace speech = freetalk::speech;

namespace {

using Release = py::call_guard<py::gil_scoped_release>;

void bind_encoder(py::module_& m) {
  using Impl = speech::SpeechEncoderImpl;
  py::class_<speech::FrameTiming>(
      m, "FrameTiming", "When frames happen: frame i is centred at offset_s + i / rate_hz.")
      .def(py::init([](double rate_hz, double offset_s) {
             return speech::FrameTiming{rate_hz, offset_s};
           }),
           py::arg("rate_hz") = speech::FrameTiming{}.rate_hz,
           py::arg("offset_s") = speech::FrameTiming{}.offset_s)
      .def_readonly("rate_hz", &speech::FrameTiming::rate_hz)
      .def_readonly("offset_s", &speech::FrameTiming::offset_s);
  freetalk::bindings::bind_module_impl<Impl, speech::SpeechEncoderOptions>(m, "SpeechEncoderImpl")
      .def("forward", &Impl::forward, py::arg("wave"), py::arg("mask") = py::none(),
           py::arg("layer") = -1, Release())
      .def("hidden_states", &Impl::hidden_states, py::arg("wave"), py::arg("mask") = py::none(),
           Release())
      .def("extract_features", &Impl::extract_features, py::arg("wave"),
           py::arg("mask") = py::none(), Release())
      .def("encode_features", &Impl::encode_features, py::arg("features"),
           py::arg("valid_frames") = py::none(), py::arg("layer") = -1, Release())
      .def("encode_states", &Impl::encode_states, py::arg("features"),
           py::arg("valid_frames") = py::none(), Release())
      .def("num_frames", &Impl::num_frames, py::arg("num_samples"))
      .def_property_readonly("receptive_field", &Impl::receptive_field)
      .def_property_readonly("frame_stride", &Impl::frame_stride)
      .def_property_readonly("timing", &Impl::timing);
}

void bind_pretrained(py::module_& m) {
  m.def(
      "load_speech_encoder",
      [](const std::filesystem::path& dir) { return speech::load_speech_encoder(dir).ptr(); },
      py::arg("dir"), Release());
  m.def(
      "save_speech_encoder",
      [](const std::shared_ptr<speech::SpeechEncoderImpl>& encoder,
         const std::filesystem::path& dir, bool half, const std::string& extra_json) {
        speech::save_speech_encoder(speech::SpeechEncoder(encoder), dir, half, extra_json);
      },
      py::arg("encoder"), py::arg("dir"), py::kw_only(), py::arg("half") = false,
      py::arg("extra_json") = "{}", Release());
}

void bind_features(py::module_& m) {
  m.def("normalize_wave", &speech::normalize_wave, py::arg("wave"), py::arg("mask") = py::none(),
        Release());
  m.def("num_motion_frames", &speech::num_motion_frames, py::arg("num_samples"), py::arg("fps"));
  m.def("resample_features",
        py::overload_cast<const at::Tensor&, int64_t>(&speech::resample_features),
        py::arg("features"), py::arg("num_frames"), Release());
  m.def("resample_features",
        py::overload_cast<const at::Tensor&, int64_t, double, speech::FrameTiming,
                          const std::optional<at::Tensor>&>(&speech::resample_features),
        py::arg("features"), py::arg("num_frames"), py::arg("fps"), py::arg("timing"),
        py::arg("valid_frames") = py::none(), Release());
  m.def(
      "encode_speech",
      [](const std::shared_ptr<speech::SpeechEncoderImpl>& encoder, const at::Tensor& samples,
         std::optional<double> fps, const speech::EncodeOptions& options,
         const std::optional<std::function<void(double)>>& progress,
         const std::optional<at::Tensor>& layer_weights) {
        speech::SpeechEncoder holder(encoder);
        return speech::encode_speech(holder, samples, fps, options, progress.value_or(nullptr),
                                     layer_weights);
      },
      py::arg("encoder"), py::arg("samples"), py::arg("fps"), py::kw_only(), py::arg("options"),
      py::arg("progress") = py::none(), py::arg("layer_weights") = py::none(), Release());
  m.def(
      "motion_features",
      [](const std::shared_ptr<speech::SpeechEncoderImpl>& encoder, const at::Tensor& wave,
         const std::optional<at::Tensor>& mask, int64_t num_frames, double fps,
         const speech::EncodeOptions& options, const std::optional<at::Tensor>& layer_weights) {
        speech::SpeechEncoder holder(encoder);
        return speech::motion_features(holder, wave, mask, num_frames, fps, options, layer_weights);
      },
      py::arg("encoder"), py::arg("wave"), py::arg("mask"), py::kw_only(), py::arg("num_frames"),
      py::arg("fps"), py::arg("options"), py::arg("layer_weights") = py::none(), Release());
}

void bind_stream(py::module_& m) {
  m.def("stream_options", &speech::stream_options, "EncodeOptions for a stream.");
  py::class_<speech::SpeechStream>(m, "SpeechStream",
                                   "Speech features while the speech is being recorded.")
      .def(py::init([](const std::shared_ptr<speech::SpeechEncoderImpl>& encoder,
                       std::optional<double> fps, const speech::EncodeOptions& options,
                       const std::optional<at::Tensor>& layer_weights) {
             return std::make_unique<speech::SpeechStream>(speech::SpeechEncoder(encoder), fps,
                                                           options, layer_weights);
           }),
           py::arg("encoder"), py::arg("fps"), py::kw_only(), py::arg("options"),
           py::arg("layer_weights") = py::none())
      .def("push", &speech::SpeechStream::push, py::arg("samples"), Release())
      .def("finish", &speech::SpeechStream::finish, Release())
      .def_property_readonly("latency_s", &speech::SpeechStream::latency_s);
}

}  // namespace

void bind_speech(py::module_& m) {
  m.attr("SAMPLE_RATE_HZ") = speech::kSampleRateHz;
  freetalk::bindings::bind_options<speech::SpeechEncoderOptions>(
      m, "SpeechEncoderOptions",
      "Options of a HuBERT or wav2vec 2.0 encoder, named as in Hugging Face's config.json.");
  freetalk::bindings::bind_options<speech::EncodeOptions>(
      m, "EncodeOptions", "How encode_speech and SpeechStream work through speech of any length.");
  m.def("hubert_base", &speech::hubert_base, "Options of facebook/hubert-base-ls960.");
  m.def("hubert_large", &speech::hubert_large, "Options of facebook/hubert-large-ll60k.");
  m.def("hubert_xlarge", &speech::hubert_xlarge, "Options of facebook/hubert-xlarge-ll60k.");
  m.def("wav2vec2_base", &speech::wav2vec2_base, "Options of facebook/wav2vec2-base.");
  m.def("wav2vec2_large", &speech::wav2vec2_large, "Options of facebook/wav2vec2-large.");
  m.def("wav2vec2_large_lv60", &speech::wav2vec2_large_lv60,
        "Options of facebook/wav2vec2-large-lv60 and facebook/wav2vec2-large-xlsr-53.");
  m.def("hubert_tiny", &speech::hubert_tiny, "Options of a small HuBERT for two CPU cores.");
  bind_encoder(m);
  bind_pretrained(m);
  bind_features(m);
  bind_stream(m);
}
