#include "freetalk/metrics/affect.h"

#include <ATen/ATen.h>

#include <algorithm>

#include "freetalk/core/error.h"
#include "select.h"

namespace freetalk::metrics {
namespace {

at::Tensor checked_features(const at::Tensor& features, const char* where) {
  FREETALK_CHECK(features.defined() && features.dim() == 2 && features.numel() > 0 &&
                     features.is_floating_point(),
                 where, ": expected features (N, F) floating point and not empty, found ",
                 features.sizes());
  return features.to(at::kDouble);
}

int64_t index_of(const std::vector<std::string>& sorted, const std::string& name) {
  return std::lower_bound(sorted.begin(), sorted.end(), name) - sorted.begin();
}

}  // namespace

at::Tensor affect_features(const at::Tensor& motion, const Selection& selection) {
  check_motion(motion, "affect_features", "motion");
  const at::Tensor valid = valid_frames(selection.valid, motion, 1, "affect_features");
  const at::Tensor indices = vertex_indices(selection, motion, "affect_features");
  const at::Tensor values = take_vertices(motion, indices).flatten(2);  // (B, T, 3M)
  const at::Tensor mean = mean_over_frames(values, valid);
  const at::Tensor variance = mean_over_frames((values - mean.unsqueeze(1)).square(), valid);
  return at::cat({mean, variance.sqrt()}, 1);
}

NearestCentroid::NearestCentroid(const at::Tensor& features, const std::vector<std::string>& labels,
                                 double floor)
    : classes_(labels) {
  const at::Tensor values = checked_features(features, "NearestCentroid");
  FREETALK_CHECK(values.size(0) == static_cast<int64_t>(labels.size()),
                 "NearestCentroid: ", values.size(0), " feature vectors but ", labels.size(),
                 " labels");
  FREETALK_CHECK(floor > 0, "NearestCentroid: floor must be above 0, found ", floor);
  std::sort(classes_.begin(), classes_.end());
  classes_.erase(std::unique(classes_.begin(), classes_.end()), classes_.end());
  std::vector<int64_t> codes;
  for (const auto& label : labels) codes.push_back(index_of(classes_, label));
  const at::Tensor code = at::tensor(codes, at::kLong).to(values.device());
  const auto count = static_cast<int64_t>(classes_.size());
  const at::Tensor sums =
      at::zeros({count, values.size(1)}, values.options()).index_add(0, code, values);
  const at::Tensor sizes = at::bincount(code, {}, count).to(at::kDouble);
  centroids_ = sums / sizes.unsqueeze(1);
  spread_ = (values - centroids_.index_select(0, code)).std(0, /*unbiased=*/false) + floor;
}

std::vector<std::string> NearestCentroid::predict(const at::Tensor& features) const {
  const at::Tensor values = checked_features(features, "NearestCentroid.predict");
  FREETALK_CHECK(values.size(1) == centroids_.size(1), "NearestCentroid.predict: expected ",
                 centroids_.size(1), " features, found ", values.size(1));
  const at::Tensor offsets = (values.unsqueeze(1) - centroids_) / spread_;  // (N, C, F)
  const at::Tensor nearest = offsets.square().sum(2).argmin(1).cpu();
  std::vector<std::string> result;
  for (int64_t i = 0; i < nearest.numel(); ++i) {
    result.push_back(classes_[static_cast<size_t>(nearest[i].item<int64_t>())]);
  }
  return result;
}

std::vector<bool> recognised(const at::Tensor& features, const at::Tensor& reference,
                             const std::vector<std::string>& labels, double floor) {
  const at::Tensor own = checked_features(features, "recognised");
  const at::Tensor known = checked_features(reference, "recognised");
  FREETALK_CHECK(own.sizes() == known.sizes(), "recognised: features ", own.sizes(),
                 " and reference ", known.sizes(), " differ in shape");
  for (const auto& label : labels) {
    FREETALK_CHECK(std::count(labels.begin(), labels.end(), label) >= 2, "recognised: '", label,
                   "' has one sequence, which leaves none to know it by: give two at least");
  }
  std::vector<bool> result;
  for (int64_t i = 0; i < own.size(0); ++i) {
    std::vector<std::string> others = labels;
    others.erase(others.begin() + i);
    const at::Tensor rest =
        at::cat({known.narrow(0, 0, i), known.narrow(0, i + 1, known.size(0) - i - 1)});
    const NearestCentroid classifier(rest, others, floor);
    result.push_back(classifier.predict(own.narrow(0, i, 1))[0] == labels[static_cast<size_t>(i)]);
  }
  return result;
}

}  // namespace freetalk::metrics
