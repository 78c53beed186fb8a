#include <torch/extension.h>

#include "bind_options.h"
#include "freetalk/core/random.h"
#include "freetalk/metrics/affect.h"
#include "freetalk/metrics/dynamics.h"
#include "freetalk/metrics/lips.h"
#include "freetalk/metrics/registry.h"
#include "freetalk/metrics/samples.h"
#include "freetalk/metrics/statistics.h"

namespace py = pybind11;
namespace fm = freetalk::metrics;

namespace {

using OptionalTensor = std::optional<at::Tensor>;
using NoGil = py::call_guard<py::gil_scoped_release>;

fm::Selection selection(const OptionalTensor& vertices, const OptionalTensor& valid,
                        const OptionalTensor& target_valid = std::nullopt) {
  return {vertices.value_or(at::Tensor()), valid.value_or(at::Tensor()),
          target_valid.value_or(at::Tensor())};
}

void bind_registry(py::module_& m) {
  py::class_<fm::MetricInfo>(m, "MetricInfo", "What a vertex metric measures, and where from.")
      .def_readonly("name", &fm::MetricInfo::name)
      .def_readonly("title", &fm::MetricInfo::title, "As tables print it.")
      .def_readonly("mask", &fm::MetricInfo::mask, "'lips', 'upper' or 'all'.")
      .def_readonly("unit", &fm::MetricInfo::unit, "Of motion in metres.")
      .def_readonly("pooling", &fm::MetricInfo::pooling, "'frames' or 'sequences'.")
      .def_readonly("ideal", &fm::MetricInfo::ideal, "What a perfect prediction scores.")
      .def_readonly("two_sided", &fm::MetricInfo::two_sided, "Nearer to ideal is better.")
      .def_readonly("formula", &fm::MetricInfo::formula)
      .def_readonly("source", &fm::MetricInfo::source);
  m.def("vertex_metrics", &fm::vertex_metrics);
  m.def("metric_info", &fm::metric_info, py::arg("name"));
  m.def(
      "vertex_metric",
      [](const std::string& name, const at::Tensor& pred, const at::Tensor& target,
         const OptionalTensor& vertices, const OptionalTensor& valid,
         const OptionalTensor& target_valid, double fps) {
        return fm::vertex_metric(name, pred, target, fps, selection(vertices, valid, target_valid));
      },
      py::arg("name"), py::arg("pred"), py::arg("target"), py::kw_only(),
      py::arg("vertices") = py::none(), py::arg("valid") = py::none(),
      py::arg("target_valid") = py::none(), py::arg("fps") = 0.0, NoGil());
  m.def(
      "jerk_energy",
      [](const at::Tensor& motion, double fps, const OptionalTensor& vertices,
         const OptionalTensor& valid) {
        return fm::jerk_energy(motion, fps, selection(vertices, valid));
      },
      py::arg("motion"), py::arg("fps"), py::kw_only(), py::arg("vertices") = py::none(),
      py::arg("valid") = py::none(), NoGil());
}

void bind_samples(py::module_& m) {
  m.def("diversity", &fm::diversity, py::arg("codes"), NoGil());
  m.def(
      "diversity_vertex",
      [](const at::Tensor& samples, const OptionalTensor& vertices, const OptionalTensor& valid) {
        return fm::diversity_vertex(samples, selection(vertices, valid));
      },
      py::arg("samples"), py::kw_only(), py::arg("vertices") = py::none(),
      py::arg("valid") = py::none(), NoGil());
  const auto bind = [&m](const char* name, auto function) {
    m.def(
        name,
        [function](const at::Tensor& samples, const at::Tensor& target,
                   const OptionalTensor& vertices, const OptionalTensor& valid) {
          return function(samples, target, selection(vertices, valid));
        },
        py::arg("samples"), py::arg("target"), py::kw_only(), py::arg("vertices") = py::none(),
        py::arg("valid") = py::none(), NoGil());
  };
  bind("lve_mean_estimate", fm::lve_mean_estimate);
  bind("lve_coverage", fm::lve_coverage);
}

void bind_lips(py::module_& m) {
  m.def("lip_opening", &fm::lip_opening, py::arg("motion"), py::arg("upper"), py::kw_only(),
        py::arg("lower"), py::arg("up"), NoGil());
  m.def(
      "correlation",
      [](const at::Tensor& a, const at::Tensor& b, const OptionalTensor& valid) {
        return fm::correlation(a, b, valid.value_or(at::Tensor()));
      },
      py::arg("a"), py::arg("b"), py::kw_only(), py::arg("valid") = py::none(), NoGil());
  m.def(
      "lip_closures",
      [](const at::Tensor& opening,
         const std::vector<std::tuple<double, double, std::string>>& phones, double fps,
         double closed, double share, double largest) {
        std::vector<fm::Phone> sounds;
        for (const auto& [start_s, end_s, label] : phones)
          sounds.push_back({start_s, end_s, label});
        return fm::lip_closures(opening, sounds, fps, {closed, share, largest});
      },
      py::arg("opening"), py::arg("phones"), py::kw_only(), py::arg("fps"), py::arg("closed"),
      py::arg("share"), py::arg("largest"), NoGil());
  m.def("log_energy", &fm::log_energy, py::arg("wave"), py::arg("num_frames"), py::kw_only(),
        py::arg("fps"), py::arg("sample_rate_hz"), NoGil());
  m.def(
      "best_offset",
      [](const at::Tensor& follower, const at::Tensor& leader, double fps, double max_offset_ms) {
        const auto offset = fm::best_offset(follower, leader, fps, max_offset_ms);
        return std::pair{offset.offset_ms, offset.correlation};
      },
      py::arg("follower"), py::arg("leader"), py::kw_only(), py::arg("fps"),
      py::arg("max_offset_ms"), NoGil());
}

void bind_affect(py::module_& m) {
  m.def(
      "affect_features",
      [](const at::Tensor& motion, const OptionalTensor& vertices, const OptionalTensor& valid) {
        return fm::affect_features(motion, selection(vertices, valid));
      },
      py::arg("motion"), py::kw_only(), py::arg("vertices") = py::none(),
      py::arg("valid") = py::none(), NoGil());
  py::class_<fm::NearestCentroid>(m, "NearestCentroid", "Labels by the nearest class mean.")
      .def(py::init<const at::Tensor&, const std::vector<std::string>&, double>(),
           py::arg("features"), py::arg("labels"), py::kw_only(), py::arg("floor"), NoGil())
      .def("predict", &fm::NearestCentroid::predict, py::arg("features"), NoGil())
      .def_property_readonly("classes", &fm::NearestCentroid::classes);
  m.def("recognised", &fm::recognised, py::arg("features"), py::arg("reference"), py::kw_only(),
        py::arg("labels"), py::arg("floor"), NoGil());
}

void bind_statistics(py::module_& m) {
  freetalk::bindings::bind_options<fm::BootstrapOptions>(m, "BootstrapOptions",
                                                         "Bootstrap over sequences.");
  py::class_<fm::Interval>(m, "Interval", "A mean and its confidence interval.")
      .def_readonly("mean", &fm::Interval::mean)
      .def_readonly("low", &fm::Interval::low)
      .def_readonly("high", &fm::Interval::high);
  py::class_<fm::PairedTest>(m, "PairedTest", "Outcome of a paired test.")
      .def_readonly("statistic", &fm::PairedTest::statistic)
      .def_readonly("p_value", &fm::PairedTest::p_value, "Two-sided.");
  m.def(
      "bootstrap_mean",
      [](const at::Tensor& values, const OptionalTensor& weights,
         const fm::BootstrapOptions& options, uint64_t seed) {
        return fm::bootstrap_mean(values, weights.value_or(at::Tensor()), options,
                                  freetalk::core::make_generator(seed));
      },
      py::arg("values"), py::arg("weights"), py::kw_only(), py::arg("options"), py::arg("seed"),
      NoGil());
  m.def(
      "permutation_test",
      [](const at::Tensor& a, const at::Tensor& b, const OptionalTensor& weights,
         int64_t num_resamples, uint64_t seed) {
        return fm::permutation_test(a, b, weights.value_or(at::Tensor()), num_resamples,
                                    freetalk::core::make_generator(seed));
      },
      py::arg("a"), py::arg("b"), py::kw_only(), py::arg("weights"), py::arg("num_resamples"),
      py::arg("seed"), NoGil());
  m.def("wilcoxon_test", &fm::wilcoxon_test, py::arg("a"), py::arg("b"), NoGil());
  m.def("holm", &fm::holm, py::arg("p_values"));
}

}  // namespace

void bind_metrics(py::module_& m) {
  bind_registry(m);
  bind_samples(m);
  bind_lips(m);
  bind_affect(m);
  bind_statistics(m);
}
