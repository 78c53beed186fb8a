#include "freetalk/talker/talker.h"

#include <pybind11/functional.h>
#include <pybind11/stl/filesystem.h>
#include <torch/extension.h>

#include "bind_options.h"

namespace {

namespace py = pybind11;
namespace talker = freetalk::talker;
using NoGil = py::call_guard<py::gil_scoped_release>;

talker::Talker load(const std::filesystem::path& directory,
                    const std::optional<std::string>& device) {
  if (!device) return talker::Talker::from_pretrained(directory);
  return talker::Talker::from_pretrained(directory, c10::Device(*device));
}

}  // namespace

void bind_talker(py::module_& m) {
  freetalk::bindings::bind_options<talker::TalkerOptions>(m, "TalkerOptions",
                                                          "How a face is animated.");
  py::class_<talker::Report>(m, "Report", "What was found, guessed and measured on the way.")
      .def_readonly("alignment", &talker::Report::alignment)
      .def_readonly("parts", &talker::Report::parts)
      .def_readonly("notices", &talker::Report::notices)
      .def_property_readonly("timings", [](const talker::Report& self) {
        py::dict seconds;
        for (const auto& timing : self.timings) seconds[py::str(timing.stage)] = timing.seconds;
        return seconds;
      });
  py::class_<talker::Talker>(m, "Talker", "The whole pipeline behind one object.")
      .def_static("from_pretrained", &load, py::arg("directory"), py::arg("device") = py::none(),
                  NoGil())
      .def(
          "animate",
          [](talker::Talker& self, const freetalk::audio::Audio& audio,
             const freetalk::mesh::Mesh& mesh, const talker::TalkerOptions& options,
             const talker::Progress& progress) {
            talker::Report report;
            auto result = self.animate(audio, mesh, options, progress, &report);
            return std::pair{std::move(result), std::move(report)};
          },
          py::arg("audio"), py::arg("mesh"), py::arg("options") = talker::TalkerOptions{},
          py::arg("progress") = talker::Progress{}, NoGil())
      .def(
          "animate_many",
          [](talker::Talker& self, const freetalk::audio::Audio& audio,
             const freetalk::mesh::Mesh& mesh, const std::vector<int64_t>& seeds,
             const talker::TalkerOptions& options, const talker::Progress& progress) {
            talker::Report report;
            auto result = self.animate_many(audio, mesh, seeds, options, progress, &report);
            return std::pair{std::move(result), std::move(report)};
          },
          py::arg("audio"), py::arg("mesh"), py::kw_only(), py::arg("seeds"),
          py::arg("options") = talker::TalkerOptions{}, py::arg("progress") = talker::Progress{},
          NoGil())
      .def("align", &talker::Talker::align, py::arg("mesh"),
           py::arg("options") = freetalk::geometry::AlignOptions{}, NoGil())
      .def_property_readonly("emotions", &talker::Talker::emotions)
      .def_property_readonly("device",
                             [](const talker::Talker& self) { return self.device().str(); });
}
