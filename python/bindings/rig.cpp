#include "freetalk/rig/face_rig.h"

#include <pybind11/functional.h>
#include <pybind11/stl/filesystem.h>
#include <torch/extension.h>

#include "bind_options.h"

namespace py = pybind11;
namespace fr = freetalk::rig;

void bind_rig(py::module_& m) {
  using NoGil = py::call_guard<py::gil_scoped_release>;
  using Progress = std::function<void(double)>;
  freetalk::bindings::bind_options<fr::RigOptions>(m, "RigOptions", "How a rig is made.");
  py::class_<fr::RigPoses>(m, "RigPoses", "Landmark motion that rigs are made of.")
      .def(py::init([](std::vector<std::string> names, const at::Tensor& shapes,
                       const at::Tensor& library) {
             fr::RigPoses poses{std::move(names), shapes, library};
             poses.check();
             return poses;
           }),
           py::arg("names"), py::arg("shapes"), py::kw_only(), py::arg("library"))
      .def_static("load", &fr::RigPoses::load, py::arg("path"), NoGil())
      .def_readonly("names", &fr::RigPoses::names)
      .def_readonly("shapes", &fr::RigPoses::shapes)
      .def_readonly("library", &fr::RigPoses::library);
  py::class_<fr::SolveState, std::shared_ptr<fr::SolveState>>(
      m, "SolveState", "What a stream carries from frame to frame.")
      .def(py::init<>())
      .def_readonly("shapes", &fr::SolveState::shapes);
  py::class_<fr::FaceRig, std::shared_ptr<fr::FaceRig>>(m, "FaceRig",
                                                        "A face as named targets and correctives.")
      .def_static("build", &fr::FaceRig::build, py::arg("decode"), py::arg("poses"), py::kw_only(),
                  py::arg("options") = fr::RigOptions{}, py::arg("progress") = Progress{}, NoGil())
      .def_static("cached", &fr::FaceRig::cached, py::arg("content"), py::arg("cache_dir"),
                  py::kw_only(), py::arg("decode"), py::arg("poses"),
                  py::arg("options") = fr::RigOptions{}, py::arg("progress") = Progress{}, NoGil())
      .def_static("load", &fr::FaceRig::load, py::arg("path"), NoGil())
      .def("save", &fr::FaceRig::save, py::arg("path"), NoGil())
      .def_property_readonly("names", &fr::FaceRig::names)
      .def_property_readonly("targets", &fr::FaceRig::targets)
      .def_property_readonly("num_shapes", &fr::FaceRig::num_shapes)
      .def_property_readonly("num_vertices", &fr::FaceRig::num_vertices)
      .def_property_readonly("options", &fr::FaceRig::options)
      .def(
          "solve",
          [](const fr::FaceRig& self, const at::Tensor& landmarks,
             const std::optional<std::shared_ptr<fr::SolveState>>& state) {
            return self.solve(landmarks, state ? state->get() : nullptr);
          },
          py::arg("landmarks"), py::arg("state") = py::none(), NoGil())
      .def("vertices", &fr::FaceRig::vertices, py::arg("weights"), NoGil());
}
