#include "freetalk/metrics/registry.h"

#include <algorithm>

#include "freetalk/core/error.h"
#include "freetalk/core/options.h"
#include "freetalk/metrics/dynamics.h"
#include "freetalk/metrics/trajectory.h"
#include "freetalk/metrics/vertex_error.h"

namespace freetalk::metrics {
namespace {

using Function = at::Tensor (*)(const at::Tensor&, const at::Tensor&, const Selection&);

struct Entry {
  MetricInfo info;
  Function function;  // null for jerk_energy, which needs fps and no target
};

constexpr const char* kProse = "FreeTalk 4.1 (prose); the formula is freetalk's";
constexpr const char* kPublicCode = "CodeTalker, FaceDiffuser, ScanTalk";

const std::vector<Entry>& entries() {
  static const std::vector<Entry> all = {
      {{"lve", "LVE", "lips", "m^2", "frames", 0, false, "mean_t max_v |p_tv - g_tv|^2",
        "CodeTalker, FaceDiffuser, ScanTalk, torchmetrics"},
       lve},
      {{"lve_l2", "LVE (L2)", "lips", "m", "frames", 0, false, "mean_t max_v |p_tv - g_tv|",
        "FreeTalk 4.1 to the letter"},
       lve_l2},
      {{"mve_mean", "MVE", "all", "m", "frames", 0, false, "mean_t mean_v |p_tv - g_tv|",
        "FaceDiffuser, ScanTalk; the numbers of FreeTalk's tables"},
       mve_mean},
      {{"mve_max", "MVE (max)", "all", "m", "frames", 0, false, "mean_t max_v |p_tv - g_tv|",
        "FreeTalk 4.1 to the letter"},
       mve_max},
      {{"fdd", "FDD", "upper", "m^2", "sequences", 0, true,
        "mean_v (std_t |g_tv|^2 - std_t |p_tv|^2)", kPublicCode},
       fdd},
      {{"fdd_abs", "|FDD|", "upper", "m^2", "sequences", 0, false,
        "|mean_v (std_t |g_tv|^2 - std_t |p_tv|^2)|", "FaceDiffuser, ScanTalk"},
       fdd_abs},
      {{"dtw", "DTW", "lips", "m", "sequences", 0, false,
        "1/T' min_path sum_path mean_v |p_tv - g_sv|", kProse},
       dtw},
      {{"dtw_sum", "DTW (sum)", "lips", "m", "sequences", 0, false,
        "min_path sum_path mean_v |p_tv - g_sv|", "Sakoe and Chiba 1978"},
       dtw_sum},
      {{"dtw_vertex", "DTW (vertex)", "lips", "m", "sequences", 0, false,
        "mean_v 1/T' min_path sum_path |p_tv - g_sv|", kProse},
       dtw_vertex},
      {{"dfd", "DFD", "lips", "m", "sequences", 0, false, "min_path max_path mean_v |p_tv - g_sv|",
        "Eiter and Mannila 1994"},
       dfd},
      {{"dfd_vertex", "DFD (vertex)", "lips", "m", "sequences", 0, false,
        "mean_v min_path max_path |p_tv - g_sv|", kProse},
       dfd_vertex},
      {{"delta_m", "delta_M", "all", "m^2", "sequences", 0, false, "mean_t mean_v |u_tv - w_tv|^2",
        kProse},
       delta_m},
      {{"delta_m_l2", "delta_M (L2)", "all", "m", "sequences", 0, false,
        "mean_t mean_v |u_tv - w_tv|", kProse},
       delta_m_l2},
      {{"delta_cd", "delta_Cd", "all", "1", "sequences", 0, false,
        "mean_t mean_v 1 - cos(u_tv, w_tv)", kProse},
       delta_cd},
      {{"delta_cd_weighted", "delta_Cd (weighted)", "all", "1", "sequences", 0, false,
        "sum_tv |w_tv| (1 - cos(u_tv, w_tv)) / sum_tv |w_tv|", "freetalk"},
       delta_cd_weighted},
      {{"jitter_ratio", "jitter", "all", "1", "sequences", 1, true,
        "jerk energy of p / jerk energy of g", "freetalk"},
       jitter_ratio},
      {{"jerk_energy", "jerk energy", "all", "m^2/s^6", "sequences", 0, false,
        "mean_t mean_v |p_(t+3)v - 3 p_(t+2)v + 3 p_(t+1)v - p_tv|^2 fps^6", "freetalk"},
       nullptr},
  };
  return all;
}

const Entry& entry(const std::string& name) {
  std::vector<std::string> names;
  for (const auto& candidate : entries()) {
    if (candidate.info.name == name) return candidate;
    names.push_back(candidate.info.name);
  }
  FREETALK_CHECK(false, "no metric is named '", name, "'; did you mean '",
                 core::nearest_name(name, names), "'?");
}

}  // namespace

const std::vector<MetricInfo>& vertex_metrics() {
  static const std::vector<MetricInfo> infos = [] {
    std::vector<MetricInfo> result;
    for (const auto& each : entries()) result.push_back(each.info);
    return result;
  }();
  return infos;
}

const MetricInfo& metric_info(const std::string& name) { return entry(name).info; }

at::Tensor vertex_metric(const std::string& name, const at::Tensor& pred, const at::Tensor& target,
                         double fps, const Selection& selection) {
  const Function function = entry(name).function;
  return function ? function(pred, target, selection) : jerk_energy(pred, fps, selection);
}

}  // namespace freetalk::metrics
