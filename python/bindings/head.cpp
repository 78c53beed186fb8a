#include <pybind11/eigen.h>
#include <pybind11/functional.h>
#include <torch/extension.h>

#include "bind_module.h"
#include "freetalk/core/random.h"
#include "freetalk/head/fit.h"
#include "freetalk/head/parametric_head.h"
#include "freetalk/head/prepared_head.h"
#include "freetalk/head/smoothing.h"
#include "freetalk/head/surface.h"
#include "freetalk/head/track.h"

namespace py = pybind11;
namespace fh = freetalk::head;
using freetalk::bindings::value_or_undefined;

namespace {

using Release = py::call_guard<py::gil_scoped_release>;

void bind_parametric_head(py::module_& m) {
  freetalk::bindings::bind_options<fh::HeadOptions>(m, "HeadOptions",
                                                    "Options of a neural parametric head.");
  m.def("nphm_paper_options", &fh::nphm_paper_options, "Options of the published NPHM.");
  m.def("nphm_small_options", &fh::nphm_small_options, "Options of the head that ships.");
  freetalk::bindings::bind_module_impl<fh::ParametricHeadImpl, fh::HeadOptions>(
      m, "ParametricHeadImpl")
      .def("forward", &fh::ParametricHeadImpl::forward, py::arg("points"), py::arg("z_id"),
           py::arg("z_exp"), Release())
      .def(
          "canonical_sdf",
          [](fh::ParametricHeadImpl& self, const at::Tensor& points, const at::Tensor& z_id,
             const std::optional<at::Tensor>& z_exp, const std::optional<at::Tensor>& hyper) {
            return self.canonical_sdf(points, z_id, value_or_undefined(z_exp),
                                      value_or_undefined(hyper));
          },
          py::arg("points"), py::arg("z_id"), py::kw_only(), py::arg("z_exp") = py::none(),
          py::arg("hyper") = py::none(), Release())
      .def(
          "to_canonical",
          [](fh::ParametricHeadImpl& self, const at::Tensor& points, const at::Tensor& z_id,
             const at::Tensor& z_exp) -> std::pair<at::Tensor, std::optional<at::Tensor>> {
            const fh::CanonicalPoints result = self.to_canonical(points, z_id, z_exp);
            if (!result.hyper.defined()) return {result.points, std::nullopt};
            return {result.points, result.hyper};
          },
          py::arg("points"), py::arg("z_id"), py::arg("z_exp"), Release())
      .def("to_posed", &fh::ParametricHeadImpl::to_posed, py::arg("points"), py::arg("z_id"),
           py::arg("z_exp"), Release())
      .def("anchors", &fh::ParametricHeadImpl::anchors, py::arg("z_id"), Release())
      .def("identity_code", &fh::ParametricHeadImpl::identity_code, py::arg("coefficients"),
           Release())
      .def("expression_code", &fh::ParametricHeadImpl::expression_code, py::arg("weights"),
           Release())
      .def("symmetry_distance", &fh::ParametricHeadImpl::symmetry_distance, py::arg("z_id"),
           Release())
      .def(
          "sample_identity",
          [](fh::ParametricHeadImpl& self, int64_t count, uint64_t seed) {
            return self.sample_identity(
                count, freetalk::core::make_generator(seed, self.identity_mean.device()));
          },
          py::arg("count"), py::kw_only(), py::arg("seed"), Release())
      .def_property_readonly("identity_dim", &fh::ParametricHeadImpl::identity_dim);
}

void bind_prepared_head(py::module_& m) {
  freetalk::bindings::bind_options<fh::PreparedOptions>(m, "PreparedOptions",
                                                        "How a head is made ready for inference.");
  py::class_<fh::PreparedHead>(m, "PreparedHead")
      .def(py::init([](const std::shared_ptr<fh::ParametricHeadImpl>& head, const at::Tensor& z_id,
                       const fh::PreparedOptions& options) {
             return fh::PreparedHead(fh::ParametricHead(head), z_id, options);
           }),
           py::arg("head"), py::arg("z_id"), py::arg("options"), Release())
      .def(
          "canonical_sdf",
          [](const fh::PreparedHead& self, const at::Tensor& points,
             const std::optional<at::Tensor>& z_exp, const std::optional<at::Tensor>& hyper,
             bool fade) {
            const at::Tensor expression = value_or_undefined(z_exp);
            return fade ? self.canonical_sdf(points, expression, value_or_undefined(hyper))
                        : self.unfaded_sdf(points, expression, value_or_undefined(hyper));
          },
          py::arg("points"), py::kw_only(), py::arg("z_exp") = py::none(),
          py::arg("hyper") = py::none(), py::arg("fade") = true, Release())
      .def("sdf", &fh::PreparedHead::sdf, py::arg("points"), py::arg("z_exp"), Release())
      .def(
          "to_canonical",
          [](const fh::PreparedHead& self, const at::Tensor& points, const at::Tensor& z_exp) {
            return self.to_canonical(points, z_exp).points;
          },
          py::arg("points"), py::arg("z_exp"), Release())
      .def("to_posed", &fh::PreparedHead::to_posed, py::arg("points"), py::arg("z_exp"), Release())
      .def_property_readonly("anchors", &fh::PreparedHead::anchors);
}

void bind_extraction(py::module_& m) {
  freetalk::bindings::bind_options<fh::SmoothingOptions>(m, "SmoothingOptions",
                                                         "Facial smoothing [FaceTalk Eq. 11-15].");
  freetalk::bindings::bind_options<fh::SurfaceOptions>(m, "SurfaceOptions",
                                                       "Extraction of a head's surface.");
  py::class_<fh::Surface>(m, "Surface")
      .def_readonly("vertices", &fh::Surface::vertices)
      .def_readonly("faces", &fh::Surface::faces)
      .def_readonly("num_evaluations", &fh::Surface::num_evaluations);
  py::class_<fh::SurfaceExtractor>(m, "SurfaceExtractor")
      .def(py::init<const fh::PreparedHead&, const fh::SurfaceOptions&,
                    const fh::SmoothingOptions&>(),
           py::arg("head"), py::arg("options"), py::arg("smoothing"), Release())
      .def("extract", &fh::SurfaceExtractor::extract, py::arg("z_exp"), Release())
      .def("next", &fh::SurfaceExtractor::next, py::arg("z_exp"), Release());
  m.def("smoothing_weights", &fh::smoothing_weights, py::arg("head"), py::arg("points"),
        py::arg("options"), Release(), "w of Eq. 14 at points (N, 3) in head units: (N,).");
}

void bind_track(py::module_& m) {
  freetalk::bindings::bind_options<fh::TrackOptions>(m, "TrackOptions",
                                                     "A head as a mesh of fixed topology.");
  m.def(
      "track",
      [](const fh::PreparedHead& head, const at::Tensor& points, const at::Tensor& z_exp,
         const std::vector<int64_t>& refined, const fh::TrackOptions& options,
         const fh::SmoothingOptions& smoothing, const std::optional<fh::FrameCallback>& on_frame) {
        const py::gil_scoped_release release;
        return fh::track(head, points, z_exp, refined, options, smoothing,
                         on_frame.value_or(fh::FrameCallback{}));
      },
      py::arg("head"), py::arg("template_points"), py::arg("z_exp"), py::kw_only(),
      py::arg("refined"), py::arg("options"), py::arg("smoothing"),
      py::arg("on_frame") = py::none());
  m.def(
      "canonical_template",
      [](const fh::PreparedHead& head, const at::Tensor& vertices,
         const std::optional<at::Tensor>& z_exp) {
        return fh::canonical_template(head, vertices, value_or_undefined(z_exp));
      },
      py::arg("head"), py::arg("vertices"), py::arg("z_exp") = py::none(), Release());
}

void bind_fit(py::module_& m) {
  freetalk::bindings::bind_options<fh::FitOptions>(m, "FitOptions",
                                                   "Fitting of codes to points of a surface.");
  py::class_<fh::Fit>(m, "Fit")
      .def_readonly("z_id", &fh::Fit::z_id)
      .def_readonly("z_exp", &fh::Fit::z_exp)
      .def_readonly("error_mm", &fh::Fit::error_mm);
  m.def(
      "fit_expressions",
      [](const std::shared_ptr<fh::ParametricHeadImpl>& head, const at::Tensor& z_id,
         const std::vector<at::Tensor>& points, const std::optional<at::Tensor>& prior,
         const fh::FitOptions& options, uint64_t seed,
         const std::optional<fh::FitCallback>& on_step) {
        const py::gil_scoped_release release;
        return fh::fit_expressions(
            fh::ParametricHead(head), z_id, points, value_or_undefined(prior), options,
            freetalk::core::make_generator(seed), on_step.value_or(fh::FitCallback{}));
      },
      py::arg("head"), py::arg("z_id"), py::arg("points"), py::kw_only(),
      py::arg("prior") = py::none(), py::arg("options"), py::arg("seed"),
      py::arg("on_step") = py::none());
  m.def(
      "fit_identity",
      [](const std::shared_ptr<fh::ParametricHeadImpl>& head, const std::vector<at::Tensor>& points,
         const std::optional<at::Tensor>& prior, const std::optional<at::Tensor>& identity_prior,
         const fh::FitOptions& options, uint64_t seed,
         const std::optional<fh::FitCallback>& on_step) {
        const py::gil_scoped_release release;
        return fh::fit_identity(fh::ParametricHead(head), points, value_or_undefined(prior),
                                value_or_undefined(identity_prior), options,
                                freetalk::core::make_generator(seed),
                                on_step.value_or(fh::FitCallback{}));
      },
      py::arg("head"), py::arg("points"), py::kw_only(), py::arg("prior") = py::none(),
      py::arg("identity_prior") = py::none(), py::arg("options"), py::arg("seed"),
      py::arg("on_step") = py::none());
}

}  // namespace

void bind_head(py::module_& m) {
  bind_parametric_head(m);
  bind_prepared_head(m);
  bind_extraction(m);
  bind_track(m);
  bind_fit(m);
}
