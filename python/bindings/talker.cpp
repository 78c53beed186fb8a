#include "freetalk/talker/talker.h"

#include <pybind11/eigen.h>
#include <pybind11/functional.h>
#include <pybind11/numpy.h>
#include <pybind11/stl/filesystem.h>
#include <torch/extension.h>

#include "bind_options.h"
#include "freetalk/core/error.h"
#include "freetalk/core/torch_error.h"
#include "freetalk/rig/face_rig.h"
#include "freetalk/talker/live.h"

namespace {

namespace py = pybind11;
namespace talker = freetalk::talker;
using NoGil = py::call_guard<py::gil_scoped_release>;
using freetalk::audio::Audio;
using freetalk::mesh::Mesh;

talker::Talker load(const std::filesystem::path& directory,
                    const std::optional<std::string>& device) {
  if (!device) return talker::Talker::from_pretrained(directory);
  const auto parsed =
      freetalk::core::with_plain_errors("device", [&] { return c10::Device(*device); });
  return talker::Talker::from_pretrained(directory, parsed);
}

/// What a call with a report as its last arguments returns, and the report.
template <class Call>
auto with_report(const Call& call) {
  talker::Report report;
  auto result = call(&report);
  return std::pair{std::move(result), std::move(report)};
}

void bind_report(py::module_& m) {
  using talker::Report;
  py::class_<Report>(m, "Report", "What was found, guessed and measured on the way.")
      .def_readonly("alignment", &Report::alignment)
      .def_readonly("parts", &Report::parts)
      .def_readonly("notices", &Report::notices)
      .def_readonly("num_frames", &Report::num_frames, "Frames of all performances.")
      .def_readonly("decoded_frames", &Report::decoded_frames,
                    "Frames that STM decoded; the others are interpolated.")
      .def_readonly("decode_error", &Report::decode_error,
                    "Checked mean error of interpolated frames, as a share of the mean motion.")
      .def_readonly("decode_error_mm", &Report::decode_error_mm,
                    "Checked largest error of interpolated frames.")
      .def_property_readonly("timings", [](const Report& self) {
        py::dict seconds;
        for (const auto& timing : self.timings) seconds[py::str(timing.stage)] = timing.seconds;
        return seconds;
      });
}

void bind_face(py::module_& m) {
  using talker::AnimateOptions;
  using talker::Face;
  using talker::Progress;
  py::class_<Face>(m, "Face", "A mesh made ready to speak.")
      .def(
          "animate",
          [](const Face& self, const Audio& audio, const AnimateOptions& options,
             const Progress& progress, const std::optional<at::Tensor>& out) {
            return with_report([&](talker::Report* report) {
              return self.animate(audio, options, progress, report, out.value_or(at::Tensor()));
            });
          },
          py::arg("audio"), py::kw_only(), py::arg("options") = AnimateOptions{},
          py::arg("progress") = Progress{}, py::arg("out") = py::none(), NoGil())
      .def(
          "animate_many",
          [](const Face& self, const Audio& audio, const std::vector<int64_t>& seeds,
             const AnimateOptions& options, const Progress& progress,
             const std::optional<at::Tensor>& out) {
            return with_report([&](talker::Report* report) {
              return self.animate_many(audio, seeds, options, progress, report,
                                       out.value_or(at::Tensor()));
            });
          },
          py::arg("audio"), py::kw_only(), py::arg("seeds"), py::arg("options") = AnimateOptions{},
          py::arg("progress") = Progress{}, py::arg("out") = py::none(), NoGil())
      .def_static("num_frames", &Face::num_frames, py::arg("audio"), py::arg("fps"))
      .def("blend_shapes", &Face::blend_shapes, py::arg("animation"),
           py::arg("progress") = Progress{}, NoGil())
      .def("rig", &Face::rig, py::arg("progress") = Progress{},
           py::return_value_policy::reference_internal, NoGil())
      .def_property_readonly("mesh", &Face::mesh)
      .def_property_readonly("options", &Face::options)
      .def_property_readonly("report", &Face::report);
}

void bind_live(py::module_& m) {
  using talker::Live;
  using talker::LiveFrame;
  freetalk::bindings::bind_options<talker::LiveOptions>(m, "LiveOptions", "A live stream.");
  py::class_<LiveFrame>(m, "LiveFrame", "A frame of a live stream.")
      .def_readonly("index", &LiveFrame::index)
      .def_readonly("time_s", &LiveFrame::time_s, "Of the speech that it belongs to.")
      .def_readonly("landmarks", &LiveFrame::landmarks,
                    "(68, 3) float32 displacements, metres, canonical frame.")
      .def_property_readonly(
          "weights",
          [](const LiveFrame& self) -> std::optional<at::Tensor> {
            if (!self.weights.defined()) return std::nullopt;
            return self.weights;
          },
          "(W,) float32 in [0, 1] of the face's rig, None without.")
      .def_property_readonly(
          "head",
          [](const LiveFrame& self) -> std::optional<at::Tensor> {
            if (!self.head.defined()) return std::nullopt;
            return self.head;
          },
          "(4, 4) float64 rigid motion of the head, metres, canonical frame; None without "
          "head_motion.");
  py::class_<Live>(m, "Live", "Speech in as it is spoken, frames out.")
      .def(py::init<talker::Face, const talker::LiveOptions&>(), py::arg("face"),
           py::arg("options") = talker::LiveOptions{}, NoGil())
      .def(
          "push",
          [](Live& self,
             const py::array_t<float, py::array::c_style | py::array::forcecast>& samples) {
            FREETALK_CHECK(samples.ndim() == 1, "samples have ", samples.ndim(),
                           " dimensions: expected (n,), one channel");
            const std::vector<float> heard(samples.data(), samples.data() + samples.size());
            const py::gil_scoped_release release;
            return self.push(heard);
          },
          py::arg("samples"))
      .def("finish", &Live::finish, NoGil())
      .def("reset", &Live::reset, NoGil())
      .def("set_emotion", &Live::set_emotion, py::arg("emotion"), py::arg("intensity") = py::none(),
           NoGil())
      .def("decode", &Live::decode, py::arg("frame"), NoGil())
      .def(
          "head",
          [](const Live& self, const LiveFrame& frame) -> std::optional<at::Tensor> {
            if (!frame.head.defined()) return std::nullopt;
            return self.head(frame);
          },
          py::arg("frame"))
      .def_property_readonly("latency_s", &Live::latency_s)
      .def_property_readonly("fps", &Live::fps)
      .def_property_readonly("options", &Live::options)
      .def_property_readonly("num_held", &Live::num_held);
}

}  // namespace

void bind_talker(py::module_& m) {
  using talker::Talker;
  freetalk::bindings::bind_options<talker::FaceOptions>(m, "FaceOptions",
                                                        "How a face is prepared.");
  freetalk::bindings::bind_options<talker::AnimateOptions>(m, "AnimateOptions", "One performance.");
  freetalk::bindings::bind_options<talker::TalkerOptions>(m, "TalkerOptions",
                                                          "How a face is prepared and animated.");
  bind_report(m);
  bind_face(m);
  bind_live(m);
  py::class_<Talker>(m, "Talker", "The weights, shared by any number of threads.")
      .def_static("from_pretrained", &load, py::arg("directory"), py::arg("device") = py::none(),
                  NoGil())
      .def("prepare", &Talker::prepare, py::arg("mesh"), py::kw_only(),
           py::arg("options") = talker::FaceOptions{}, py::arg("progress") = talker::Progress{},
           py::arg("landmarks") = Eigen::MatrixXd(), NoGil())
      .def("prepare_head", &Talker::prepare_head, py::arg("z_id"), py::kw_only(),
           py::arg("resolution"), py::arg("options") = talker::FaceOptions{},
           py::arg("progress") = talker::Progress{}, NoGil())
      .def("sample_identity", &Talker::sample_identity, py::arg("seed"), NoGil())
      .def(
          "animate",
          [](const Talker& self, const Audio& audio, const Mesh& mesh,
             const talker::TalkerOptions& options, const talker::Progress& progress) {
            return with_report([&](talker::Report* report) {
              return self.animate(audio, mesh, options, progress, report);
            });
          },
          py::arg("audio"), py::arg("mesh"), py::arg("options") = talker::TalkerOptions{},
          py::arg("progress") = talker::Progress{}, NoGil())
      .def(
          "animate_many",
          [](const Talker& self, const Audio& audio, const Mesh& mesh,
             const std::vector<int64_t>& seeds, const talker::TalkerOptions& options,
             const talker::Progress& progress) {
            return with_report([&](talker::Report* report) {
              return self.animate_many(audio, mesh, seeds, options, progress, report);
            });
          },
          py::arg("audio"), py::arg("mesh"), py::kw_only(), py::arg("seeds"),
          py::arg("options") = talker::TalkerOptions{}, py::arg("progress") = talker::Progress{},
          NoGil())
      .def("live", &Talker::live, py::arg("face"), py::arg("options") = talker::LiveOptions{},
           NoGil())
      .def("align", &Talker::align, py::arg("mesh"),
           py::arg("options") = freetalk::geometry::AlignOptions{}, NoGil())
      .def_property_readonly("emotions", &Talker::emotions)
      .def_property_readonly("max_intensity", &Talker::max_intensity)
      .def_property_readonly("device", [](const Talker& self) { return self.device().str(); });
}
