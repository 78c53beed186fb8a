#include "freetalk/stm/adaptive_decoder.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>

#include "freetalk/core/error.h"
#include "geometry/combine_fields.h"

namespace freetalk::stm {
namespace {

using geometry::combine_fields;
using Points = geometry::GreedyInterpolation::Points;

constexpr int64_t kFirst = 16;           // frames decoded before the first check
constexpr int64_t kBatch = 8;            // frames of a check, at least
constexpr int64_t kChunk = 64;           // frames of a call to the sink
constexpr int64_t kMotionSamples = 512;  // vertices of which the mean motion is taken
constexpr double kLength = 2.0;          // of the kernel, in spreads of the clip
// Frames that are not checked may err more for their doubt than those that are. In the mean by a
// fifth, of the interpolation before the batch, whose frames were its test: doubt falls faster
// with every frame than the error does. At the worst vertex by more.
constexpr double kMeanSafety = 1.2, kMaxSafety = 1.8;

/// Landmark motion in mm about its mean.
Points points_of(const at::Tensor& landmarks) {
  const at::Tensor flat = landmarks.to(at::kCPU, at::kDouble).flatten(1).contiguous();
  Points points =
      1e3 * Eigen::Map<const Points>(flat.const_data_ptr<double>(), flat.size(0), flat.size(1));
  const Eigen::RowVectorXd mean = points.colwise().mean();
  points.rowwise() -= mean;
  return points;
}

geometry::PoseKernel kernel_of(const Points& points) {
  const double spread = std::sqrt(points.squaredNorm() /
                                  static_cast<double>(std::max<Eigen::Index>(points.rows(), 1)));
  geometry::PoseKernel kernel;
  kernel.spread = std::max(spread, 1e-6);
  kernel.length = kLength * kernel.spread;
  return kernel;
}

/// A clip, the frames decoded so far and what they say about the others.
class Clip {
 public:
  Clip(const FrameDecoder& decoder, const at::Tensor& landmarks)
      : decoder_(decoder), landmarks_(landmarks), interpolation_(points(landmarks)) {
    grow(kFirst);
    fields_ = decode(interpolation_.nodes(), 0);
  }

  int64_t decoded() const { return fields_.size(0); }

  /// Decodes the most doubtful frames and compares them with what was interpolated there.
  /// @returns false where no frame is left to doubt.
  bool check() {
    const int64_t before = decoded();
    const Eigen::VectorXd doubt = interpolation_.variance().cwiseSqrt();
    doubt_ = doubt.mean();
    grow(std::max<int64_t>(kBatch, before / 8));
    const std::vector<int64_t>& nodes = interpolation_.nodes();
    if (static_cast<int64_t>(nodes.size()) == before) return false;
    const std::vector<int64_t> checked(nodes.begin() + before, nodes.end());
    const at::Tensor exact = decode(nodes, before);
    const at::Tensor error =
        (combine_fields(interpolation_.weights(checked, before), fields_) - exact).norm(2, -1);
    const at::Tensor means = error.mean(1).cpu(), largest = error.amax(1).cpu();
    double errors = 0.0, doubts = 0.0;
    double ratio = 0.0;
    for (size_t k = 0; k < checked.size(); ++k) {
      const auto index = static_cast<int64_t>(k);
      errors += means[index].item<float>();
      doubts += doubt[checked[k]];
      ratio =
          std::max(ratio, static_cast<double>(largest[index].item<float>()) / doubt[checked[k]]);
    }
    largest_per_doubt_ = std::max(ratio, last_ratio_);  // of two checks: one holds few frames
    last_ratio_ = ratio;
    mean_per_doubt_ = errors / doubts;
    fields_ = at::cat({fields_, exact});
    return true;
  }

  /// The errors to expect of the frames that are not decoded.
  void expect(AdaptiveReport& report) const {
    const Eigen::VectorXd doubt = interpolation_.variance().cwiseSqrt();
    const int64_t step = std::max<int64_t>(1, fields_.size(1) / kMotionSamples);
    const at::Tensor sampled = fields_.slice(1, 0, std::nullopt, step).contiguous();
    const double motion = combine_fields(interpolation_.weights(decoded()), sampled)
                              .norm(2, -1)
                              .mean()
                              .item<double>();
    report.decoded = decoded();
    report.mean_error = kMeanSafety * mean_per_doubt_ * doubt_ / std::max(motion, 1e-9);
    report.max_error_mm = kMaxSafety * 1e3 * largest_per_doubt_ * doubt.maxCoeff();
  }

  void emit(const std::function<void(int64_t, const at::Tensor&)>& sink) const {
    Points weights = interpolation_.weights(decoded());
    const std::vector<int64_t>& nodes = interpolation_.nodes();
    for (size_t n = 0; n < nodes.size(); ++n) {  // Decoded frames go out as they are.
      weights.row(nodes[n]).setZero();
      weights(nodes[n], static_cast<Eigen::Index>(n)) = 1.0;
    }
    for (int64_t first = 0; first < landmarks_.size(0); first += kChunk) {
      const int64_t count = std::min(kChunk, landmarks_.size(0) - first);
      sink(first, combine_fields(weights.middleRows(first, count), fields_));
    }
  }

 private:
  static geometry::GreedyInterpolation points(const at::Tensor& landmarks) {
    Points points = points_of(landmarks);
    const geometry::PoseKernel kernel = kernel_of(points);
    return {std::move(points), kernel};
  }

  void grow(int64_t count) {
    while (count-- > 0 && interpolation_.add(interpolation_.most_doubtful())) {
    }
  }

  at::Tensor decode(const std::vector<int64_t>& nodes, int64_t from) const {
    const at::Tensor index = at::tensor(nodes).slice(0, from).to(landmarks_.device());
    return decoder_.decode(landmarks_.index_select(0, index));
  }

  const FrameDecoder& decoder_;
  at::Tensor landmarks_, fields_;  // (T, 68, 3), (n, V, 3)
  geometry::GreedyInterpolation interpolation_;
  double mean_per_doubt_ = 0.0, largest_per_doubt_ = 0.0, last_ratio_ = 0.0, doubt_ = 0.0;
};

}  // namespace

void AdaptiveOptions::check() const {
  FREETALK_CHECK(tolerance_mm >= 0, "STM: tolerance_mm must not be negative, found ", tolerance_mm);
  FREETALK_CHECK(tolerance_mean > 0, "STM: tolerance_mean must be positive, found ",
                 tolerance_mean);
}

void decode_adaptively(const FrameDecoder& decoder, const at::Tensor& landmarks,
                       const std::function<void(int64_t, const at::Tensor&)>& sink,
                       const AdaptiveOptions& options, AdaptiveReport* report,
                       const std::function<void(double)>& progress) {
  options.check();
  AdaptiveReport own;
  AdaptiveReport& found = report != nullptr ? *report : own;
  FREETALK_CHECK(landmarks.dim() == 3 && landmarks.size(1) == 68 && landmarks.size(2) == 3,
                 "STM: landmarks must be (T, 68, 3), found ", landmarks.sizes());
  const int64_t frames = landmarks.size(0);
  const auto step = [&progress](double share) {
    if (progress) progress(share);
  };
  found = {frames, frames, 0.0, 0.0};
  if (options.tolerance_mm == 0 || frames <= 2 * kFirst) {
    decoder.decode(landmarks, [&](int64_t first, const at::Tensor& part) {
      sink(first, part);
      step(static_cast<double>(first + part.size(0)) / static_cast<double>(frames));
    });
    return;
  }
  const at::NoGradGuard no_grad;
  Clip clip(decoder, landmarks);
  const auto share = [&] {  // Clips of speech end between 50 and 100 decoded frames.
    const auto decoded = static_cast<double>(clip.decoded());
    return 0.9 * decoded / (decoded + 30.0);
  };
  step(share());
  while (clip.check()) {
    clip.expect(found);
    step(share());
    if (found.mean_error <= options.tolerance_mean && found.max_error_mm <= options.tolerance_mm) {
      break;
    }
  }
  clip.expect(found);
  clip.emit([&](int64_t first, const at::Tensor& part) {
    sink(first, part);
    step(0.9 + 0.1 * static_cast<double>(first + part.size(0)) / static_cast<double>(frames));
  });
}

at::Tensor decode_adaptively(const FrameDecoder& decoder, const at::Tensor& landmarks,
                             const AdaptiveOptions& options, AdaptiveReport* report) {
  std::vector<at::Tensor> parts;
  decode_adaptively(
      decoder, landmarks, [&parts](int64_t, const at::Tensor& part) { parts.push_back(part); },
      options, report);
  FREETALK_CHECK(!parts.empty(), "STM: expected at least one frame");
  return at::cat(parts);
}

}  // namespace freetalk::stm
