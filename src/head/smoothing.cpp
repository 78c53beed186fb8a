#include "freetalk/head/smoothing.h"

#include <torch/torch.h>

#include "freetalk/core/error.h"

namespace freetalk::head {
namespace {

at::Tensor row(const std::vector<double>& values) {
  return at::tensor(values, at::kDouble).to(at::kFloat);
}

/// The smallest value of Eq. 13's exponential over the head's box, at one of its corners.
double least(const HeadOptions& head, const at::Tensor& center, const at::Tensor& sigma) {
  const at::Tensor farthest =
      at::maximum((row(head.box_min) - center).abs(), (row(head.box_max) - center).abs());
  return (farthest / sigma).square().sum().div(-2).exp().item<double>();
}

}  // namespace

void SmoothingOptions::check() const {
  FREETALK_CHECK(mode == "none" || mode == "rest" || mode == "published",
                 "smoothing mode must be none, rest or published, found ", mode);
  FREETALK_CHECK(center.empty() || center.size() == 3, "smoothing center must have 3 numbers");
  FREETALK_CHECK(sigma.size() == 3 && sigma[0] > 0 && sigma[1] > 0 && sigma[2] > 0,
                 "smoothing sigma must be 3 positive numbers");
  FREETALK_CHECK(falloff > 0, "smoothing falloff must be positive, found ", falloff);
}

at::Tensor smoothing_weights(const PreparedHead& head, const at::Tensor& points,
                             const SmoothingOptions& options) {
  options.check();
  if (options.mode == "none") return at::ones({points.size(0)}, at::kFloat);
  const at::Tensor center = options.center.empty() ? head.anchors().mean(0) : row(options.center);
  const at::Tensor sigma = row(options.sigma);
  const at::Tensor square = ((points.to(at::kFloat) - center) / sigma).square().sum(1);  // d^2
  if (options.mode == "published") {
    const double low = least(head.options(), center, sigma);
    return ((square.div(-2).exp() - low) / (1 - low)).clamp_min(0);
  }
  const at::Tensor beyond = (square.sqrt() - 1).clamp_min(0) / options.falloff;
  return beyond.square().div(-2).exp();
}

at::Tensor smoothed_offsets(const PreparedHead& head, const at::Tensor& points,
                            const at::Tensor& offsets, const at::Tensor& at_rest,
                            const SmoothingOptions& options) {
  if (options.mode == "none") return offsets;
  const at::Tensor w = smoothing_weights(head, points, options).unsqueeze(1);
  return options.mode == "published" ? w * offsets : at_rest + w * (offsets - at_rest);
}

}  // namespace freetalk::head
