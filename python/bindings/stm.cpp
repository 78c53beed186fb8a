#include "freetalk/stm/stm.h"

#include <pybind11/eigen.h>
#include <torch/extension.h>

#include "bind_module.h"
#include "freetalk/stm/adaptive_decoder.h"
#include "freetalk/stm/attention.h"
#include "freetalk/stm/frame_decoder.h"
#include "freetalk/stm/landmark_carrier.h"
#include "freetalk/stm/landmark_follower.h"
#include "freetalk/stm/landmark_graph.h"

namespace py = pybind11;
namespace fs = freetalk::stm;

void bind_stm(py::module_& m) {
  freetalk::bindings::bind_options<fs::StmOptions>(m, "StmOptions",
                                                   "Options of STM [FreeTalk 3.2].");
  py::class_<fs::MeshFeatures>(m, "MeshFeatures", "What STM computes of a mesh once.")
      .def_readonly("hidden", &fs::MeshFeatures::hidden)
      .def_readonly("queries", &fs::MeshFeatures::queries);
  const auto release = py::call_guard<py::gil_scoped_release>();
  freetalk::bindings::bind_module_impl<fs::StmImpl, fs::StmOptions>(m, "StmImpl")
      .def("forward", &fs::StmImpl::forward, py::arg("positions"), py::arg("operators"),
           py::arg("landmarks"), release)
      .def("encode", &fs::StmImpl::encode, py::arg("positions"), py::arg("operators"), release)
      .def("decode", &fs::StmImpl::decode, py::arg("mesh"), py::arg("operators"),
           py::arg("landmarks"), release)
      .def("attention", &fs::attention, py::arg("mesh"), py::arg("landmarks"), release)
      .def("frames_per_chunk", &fs::StmImpl::frames_per_chunk, py::arg("num_vertices"),
           py::arg("memory_bytes"));
  freetalk::bindings::bind_options<fs::DecodeOptions>(m, "DecodeOptions",
                                                      "Precision and memory of FrameDecoder.");
  freetalk::bindings::bind_options<fs::FollowOptions>(m, "FollowOptions",
                                                      "How landmarks are followed.");
  py::class_<fs::LandmarkFollower, std::shared_ptr<fs::LandmarkFollower>>(
      m, "LandmarkFollower", "What following the landmarks needs of a mesh.")
      .def(py::init<const Eigen::MatrixXd&, const Eigen::MatrixXi&, const Eigen::MatrixXd&,
                    const Eigen::MatrixXd&, const fs::FollowOptions&>(),
           py::arg("vertices"), py::arg("faces"), py::kw_only(), py::arg("landmarks"),
           py::arg("normals"), py::arg("options") = fs::FollowOptions{}, release)
      .def("apply", &fs::LandmarkFollower::apply, py::arg("displacements"), py::arg("landmarks"),
           release, "(T, V, 3) displacements that follow the landmarks, differentiable.")
      .def(
          "to",
          [](const fs::LandmarkFollower& self, const py::object& device) {
            return self.to(torch::python::detail::py_object_to_device(
                py::module_::import("torch").attr("device")(device)));
          },
          py::arg("device"), "A copy on a device.")
      .def_property_readonly("num_followed", &fs::LandmarkFollower::num_followed,
                             "Landmarks that are near the surface.")
      .def_property_readonly("corners", &fs::LandmarkFollower::corners, "(68, 3) int64 vertices.")
      .def_property_readonly("shares", &fs::LandmarkFollower::shares,
                             "(68, 3) barycentric on them.")
      .def_property_readonly("weights", &fs::LandmarkFollower::weights,
                             "(V, 68), 0 for landmarks that are not followed.")
      .def_property_readonly("reach", &fs::LandmarkFollower::reach, "(V, 1) in [0, 1].")
      .def_property_readonly(
          "lengths", &fs::LandmarkFollower::lengths,
          "(V, 1) m: detail of the network's motion that is finer is taken out.");
  py::class_<fs::FrameDecoder>(m, "FrameDecoder", "STM's decoder for many frames of one mesh.")
      .def(py::init<std::shared_ptr<fs::StmImpl>, const fs::MeshFeatures&,
                    const freetalk::geometry::SurfaceOperators&, const fs::DecodeOptions&,
                    std::shared_ptr<fs::LandmarkFollower>>(),
           py::arg("model"), py::arg("mesh"), py::kw_only(), py::arg("operators"),
           py::arg("options") = fs::DecodeOptions{}, py::arg("follower") = nullptr, release)
      .def("decode", py::overload_cast<const at::Tensor&>(&fs::FrameDecoder::decode, py::const_),
           py::arg("landmarks"), release, "(T, V, 3) displacements in metres.");
  py::class_<fs::LandmarkCarrier>(m, "LandmarkCarrier",
                                  "Carries the mean face's landmark motion to another face.")
      .def(py::init<const Eigen::MatrixXd&, const Eigen::MatrixXi&, const fs::LandmarkFollower&,
                    const Eigen::MatrixXd&, bool, const fs::FrameDecoder*>(),
           py::arg("vertices"), py::arg("faces"), py::kw_only(), py::arg("follower"),
           py::arg("mean"), py::arg("known"), py::arg("decoder") = nullptr, release)
      .def("apply", &fs::LandmarkCarrier::apply, py::arg("landmarks"), release,
           "(T, 68, 3) displacements of this face's landmarks, on the CPU.")
      .def_property_readonly("lip_clearance", &fs::LandmarkCarrier::lip_clearance,
                             "m at rest, of landmarks 61-67, 62-66 and 63-65.")
      .def_property_readonly("lid_clearance", &fs::LandmarkCarrier::lid_clearance,
                             "m at rest, of landmarks 37-41, 38-40, 43-47 and 44-46.");
  freetalk::bindings::bind_options<fs::AdaptiveOptions>(m, "AdaptiveOptions",
                                                        "Tolerances of decode_adaptively.");
  py::class_<fs::AdaptiveReport>(m, "AdaptiveReport", "What decode_adaptively decoded.")
      .def_readonly("frames", &fs::AdaptiveReport::frames)
      .def_readonly("decoded", &fs::AdaptiveReport::decoded)
      .def_readonly("mean_error", &fs::AdaptiveReport::mean_error)
      .def_readonly("max_error_mm", &fs::AdaptiveReport::max_error_mm);
  m.def(
      "decode_adaptively",
      [](const fs::FrameDecoder& decoder, const at::Tensor& landmarks,
         const fs::AdaptiveOptions& options) {
        fs::AdaptiveReport report;
        at::Tensor result = fs::decode_adaptively(decoder, landmarks, options, &report);
        return std::pair{std::move(result), report};
      },
      py::arg("decoder"), py::arg("landmarks"), py::kw_only(),
      py::arg("options") = fs::AdaptiveOptions{}, release);
  m.def("landmark_edges", &fs::landmark_edges);
  m.def("landmark_mirror", &fs::landmark_mirror);
  m.def("landmark_adjacency", &fs::landmark_adjacency);
}
