#include "freetalk/animation/animation.h"

#include <pybind11/eigen.h>
#include <pybind11/functional.h>
#include <pybind11/stl/filesystem.h>
#include <torch/extension.h>

#include "bind_options.h"
#include "freetalk/animation/jaw.h"
#include "freetalk/animation/morph.h"
#include "freetalk/animation/parts.h"
#include "freetalk/animation/resample.h"

namespace {

namespace py = pybind11;
namespace animation = freetalk::animation;
using NoGil = py::call_guard<py::gil_scoped_release>;

animation::Animation make_animation(const freetalk::mesh::Mesh& mesh,
                                    const at::Tensor& displacements, double fps,
                                    const std::optional<freetalk::audio::Audio>& audio,
                                    const std::string& metadata_json, double metres_per_unit,
                                    const Eigen::Matrix3d& to_y_up,
                                    const std::optional<at::Tensor>& head,
                                    const std::optional<at::Tensor>& landmarks) {
  animation::Animation result{mesh,
                              displacements.to(at::kCPU, at::kFloat).contiguous(),
                              fps,
                              audio.value_or(freetalk::audio::Audio{}),
                              metadata_json,
                              {metres_per_unit, to_y_up},
                              {},
                              {}};
  if (head) result.head = head->to(at::kCPU, at::kDouble).contiguous();
  if (landmarks) result.landmarks = landmarks->to(at::kCPU, at::kFloat).contiguous();
  result.check();
  return result;
}

void bind_animation_type(py::module_& m) {
  using animation::Animation;
  py::class_<animation::MeshFrame>(m, "MeshFrame", "How the mesh's unit and axes lie in the world.")
      .def_readonly("metres_per_unit", &animation::MeshFrame::metres_per_unit)
      .def_readonly("to_y_up", &animation::MeshFrame::to_y_up,
                    "(3, 3) mesh axes -> +Y up, +Z out.");
  py::class_<animation::SaveReport>(m, "SaveReport", "What was written.")
      .def(py::init([](const std::string& format) { return animation::SaveReport{format}; }),
           py::arg("format"))
      .def_readwrite("format", &animation::SaveReport::format)
      .def_readwrite("num_files", &animation::SaveReport::num_files)
      .def_readonly("num_morph_targets", &animation::SaveReport::num_morph_targets)
      .def_readonly("morph_error_mm", &animation::SaveReport::morph_error_mm)
      .def_readonly("into_source", &animation::SaveReport::into_source);
  py::class_<animation::BlendShapes>(m, "BlendShapes", "Named targets and their weights over time.")
      .def(py::init([](std::vector<std::string> names, const at::Tensor& targets,
                       const at::Tensor& weights) {
             return animation::BlendShapes{std::move(names), targets, weights};
           }),
           py::arg("names"), py::arg("targets"), py::arg("weights"))
      .def_readonly("names", &animation::BlendShapes::names)
      .def_readonly("targets", &animation::BlendShapes::targets, "(K, V, 3) float32, mesh's unit.")
      .def_readonly("weights", &animation::BlendShapes::weights, "(T, K) float32 in [0, 1].");
  freetalk::bindings::bind_options<animation::SaveOptions>(m, "SaveOptions",
                                                           "How an animation is written.");
  py::class_<Animation>(m, "Animation", "A mesh, its displacements over time, and the speech.")
      .def(py::init(&make_animation), py::arg("mesh"), py::arg("displacements"), py::kw_only(),
           py::arg("fps") = 30.0, py::arg("audio") = py::none(), py::arg("metadata_json") = "{}",
           py::arg("metres_per_unit") = 1.0,
           py::arg("to_y_up") = Eigen::Matrix3d(Eigen::Matrix3d::Identity()),
           py::arg("head") = py::none(), py::arg("landmarks") = py::none(), NoGil())
      .def_readonly("mesh", &Animation::mesh)
      .def_readonly("displacements", &Animation::displacements, "(T, V, 3) float32.")
      .def_property_readonly(
          "head",
          [](const Animation& self) {
            return self.head.defined() ? std::optional(self.head) : std::nullopt;
          },
          "(T, 4, 4) float64 rigid motion of the mesh, None without.")
      .def_readonly("fps", &Animation::fps)
      .def_readonly("audio", &Animation::audio)
      .def_readonly("frame", &Animation::frame)
      .def_property_readonly(
          "landmarks",
          [](const Animation& self) {
            return self.landmarks.defined() ? std::optional(self.landmarks) : std::nullopt;
          },
          "(T, 68, 3) float32, metres, canonical frame; None where not known.")
      .def_readwrite("metadata_json", &Animation::metadata_json)
      .def_property_readonly("num_frames", &Animation::num_frames)
      .def_property_readonly("duration_s", &Animation::duration_s)
      .def("vertices_at", &Animation::vertices_at, py::arg("frame_index"), NoGil())
      .def("save", &Animation::save, py::arg("path"), py::arg("options") = animation::SaveOptions{},
           py::arg("shapes") = animation::BlendShapes{},
           py::arg("progress") = animation::SaveProgress{}, NoGil());
  m.def("load_npz", &animation::load_npz, py::arg("path"), NoGil());
  m.def("load_gltf", &animation::load_gltf, py::arg("path"), py::arg("fps") = 0.0, NoGil());
  m.def("load_pc2", &animation::load_pc2, py::arg("path"), py::arg("mesh"), py::arg("fps") = 30.0,
        NoGil());
  m.def("load_sequence", &animation::load_sequence, py::arg("folder"), py::arg("fps") = 30.0,
        NoGil());
}

void bind_parts(py::module_& m) {
  using animation::PartMotion;
  py::enum_<PartMotion>(m, "PartMotion", "What a part moves with.")
      .value("FACE", PartMotion::kFace)
      .value("SURFACE", PartMotion::kSurface)
      .value("JAW", PartMotion::kJaw)
      .value("STILL", PartMotion::kStill);
  py::class_<animation::Part>(m, "Part", "One component of a mesh.")
      .def_readonly("motion", &animation::Part::motion)
      .def_readonly("num_vertices", &animation::Part::num_vertices);
  py::class_<animation::Parts>(m, "Parts", "Which parts of a head mesh move, and with what.")
      .def(py::init<const Eigen::MatrixXd&, const Eigen::MatrixXi&, const Eigen::MatrixXd&>(),
           py::arg("vertices"), py::arg("faces"), py::arg("landmarks"), NoGil())
      .def_property_readonly("parts", &animation::Parts::parts)
      .def_property_readonly("part_of_vertex", &animation::Parts::part_of_vertex)
      .def_property_readonly("jaw_share", &animation::Parts::jaw_share)
      .def_property_readonly("face_vertices", &animation::Parts::face_vertices)
      .def_property_readonly("face_faces", &animation::Parts::face_faces)
      .def("move", &animation::Parts::move, py::arg("face_displacements"), py::arg("landmarks"),
           NoGil())
      .def("summary", &animation::Parts::summary);
}

}  // namespace

void bind_animation(py::module_& m) {
  bind_animation_type(m);
  bind_parts(m);
  m.def(
      "resample_motion",
      [](const at::Tensor& motion, double from_fps, double to_fps, int64_t num_frames,
         const std::optional<at::Tensor>& landmarks) {
        return animation::resample_motion(motion, from_fps, to_fps, num_frames,
                                          landmarks.value_or(at::Tensor()));
      },
      py::arg("motion"), py::arg("from_fps"), py::arg("to_fps"), py::arg("num_frames"),
      py::arg("landmarks") = py::none(), NoGil());
  m.def(
      "morph_basis",
      [](const at::Tensor& displacements, double tolerance, int64_t max_targets) {
        const auto basis = animation::morph_basis(displacements, tolerance, max_targets);
        return std::tuple{basis.targets, basis.weights, basis.max_error};
      },
      py::arg("displacements"), py::arg("tolerance"), py::arg("max_targets"), NoGil());
  m.def(
      "fit_jaw",
      [](const Eigen::MatrixXd& rest_landmarks, const at::Tensor& displacements) {
        std::vector<std::pair<Eigen::Matrix3d, Eigen::Vector3d>> motions;
        for (const auto& motion : animation::fit_jaw(rest_landmarks, displacements)) {
          motions.emplace_back(motion.rotation, motion.translation);
        }
        return motions;
      },
      py::arg("rest_landmarks"), py::arg("displacements"), NoGil());
}
