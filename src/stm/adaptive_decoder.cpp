#include "freetalk/stm/adaptive_decoder.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>

#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "freetalk/stm/landmark_follower.h"
#include "geometry/combine_fields.h"

namespace freetalk::stm {
namespace {

using geometry::combine_fields;
using Points = geometry::GreedyInterpolation::Points;

constexpr int64_t kFirst = 16;     // frames decoded before the first check
constexpr int64_t kBatch = 8;      // frames of a check, at least
constexpr double kSpread = 0.375;  // share of them that is not of the most doubtful
constexpr int kChecks = 2;         // at least: one may be lucky
constexpr int64_t kRounded = 1;    // frames decoded exactly to see what bfloat16 does
constexpr int64_t kChunk = 64;     // frames of a call to the sink, at most
constexpr int64_t kChunkBytes = int64_t{8} << 20;
constexpr int64_t kMotionSamples = 512;  // vertices of which the mean motion is taken
constexpr double kLength = 2.0;          // of the kernel, in spreads of the clip
// Frames that are not checked may err more for their doubt than those that are.
constexpr double kMeanSafety = 1.2, kMaxSafety = 1.5;
constexpr double kRoundingShare = 0.6;  // of a tolerance, at most

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

/// Mean and largest error of a vertex, metres (or metres for each unit of doubt).
struct Errors {
  double mean = 0.0, largest = 0.0;
};

/// Of frames' displacements, (n, V, 3) each.
std::vector<Errors> errors_of(const at::Tensor& found, const at::Tensor& exact) {
  const at::Tensor error = (found - exact).norm(2, -1);
  const at::Tensor means = error.mean(1).cpu(), largest = error.amax(1).cpu();
  std::vector<Errors> result;
  for (int64_t t = 0; t < means.size(0); ++t) {
    result.push_back({means[t].item<float>(), largest[t].item<float>()});
  }
  return result;
}

/// What of an error is the interpolation's, where the decoder's rounding is on both sides of it.
double beyond(double error, double rounding) {
  return std::sqrt(std::max(error * error - rounding * rounding, 0.0));
}

/// A clip, the frames decoded so far and what they say about the others.
class Clip {
 public:
  Clip(const LandmarkDecoder& decoder, const at::Tensor& landmarks, const AdaptiveOptions& options)
      : decoder_(&decoder.fastest()), landmarks_(landmarks), interpolation_(points(landmarks)) {
    for (int64_t n = 0; n < kFirst; ++n) interpolation_.add(interpolation_.most_doubtful());
    fields_ = decode(0);
    if (decoder_ == &decoder) return;
    const at::Tensor exact = decoder.decode_once(frames(0).slice(0, 0, kRounded));
    for (const Errors& error : errors_of(fields_.slice(0, 0, exact.size(0)), exact)) {
      rounding_.mean += error.mean / static_cast<double>(exact.size(0));
      rounding_.largest = std::max(rounding_.largest, error.largest);
    }
    if (rounding_.mean <= kRoundingShare * options.tolerance_mean * mean_motion() &&
        1e3 * rounding_.largest <= kRoundingShare * options.tolerance_mm) {
      return;
    }
    decoder_ = &decoder;
    rounding_ = {};
    fields_ = decode(0);
  }

  int64_t decoded() const { return fields_.size(0); }

  /// Decodes the most doubtful frames and some others and compares them with what was interpolated
  /// there. @returns false where no frame is left to doubt.
  bool check() {
    const int64_t before = decoded(), count = std::max<int64_t>(kBatch, before / 8);
    const Eigen::VectorXd doubt = interpolation_.variance().cwiseSqrt();
    for (const int64_t frame :
         spread_over(doubt, std::lround(kSpread * static_cast<double>(count))))
      interpolation_.add(frame);
    const int64_t num_spread = num_nodes() - before;
    while (num_nodes() - before < count && interpolation_.add(interpolation_.most_doubtful())) {
    }
    if (num_nodes() == before) return false;
    const std::vector<int64_t>& nodes = interpolation_.nodes();
    const std::vector<int64_t> checked(nodes.begin() + before, nodes.end());
    const at::Tensor exact = decode(before);
    const auto errors =
        errors_of(interpolated(frames(before), interpolation_.weights(checked, before)), exact);
    double errors_sum[2]{}, doubts[2]{};  // of frames spread over all doubts, of the most doubtful
    Errors found;
    for (size_t k = 0; k < checked.size(); ++k) {
      const size_t part = static_cast<int64_t>(k) < num_spread ? 0 : 1;
      errors_sum[part] += beyond(errors[k].mean, rounding_.mean);
      doubts[part] += doubt[checked[k]];
      if (part == 0) continue;
      found.largest =
          std::max(found.largest, beyond(errors[k].largest, rounding_.largest) / doubt[checked[k]]);
    }
    const auto ratio = [&](size_t part) {
      return doubts[part] > 0 ? errors_sum[part] / doubts[part] : 0.0;
    };
    found.mean = std::max(ratio(0), (ratio(0) + ratio(1)) / 2);
    for_doubt_ = {std::max(found.mean, last_.mean), std::max(found.largest, last_.largest)};
    last_ = found;
    fields_ = at::cat({fields_, exact});
    return true;
  }

  /// The errors to expect of the frames that are not decoded.
  void expect(AdaptiveReport& report) const {
    const Eigen::VectorXd doubt = interpolation_.variance().cwiseSqrt();
    report.decoded = decoded();
    report.mean_error =
        std::hypot(kMeanSafety * for_doubt_.mean * doubt.mean(), rounding_.mean) / mean_motion();
    report.max_error_mm =
        1e3 * std::hypot(kMaxSafety * for_doubt_.largest * doubt.maxCoeff(), rounding_.largest);
  }

  void emit(const std::function<void(int64_t, const at::Tensor&)>& sink) const {
    Points weights = interpolation_.weights(decoded());
    const std::vector<int64_t>& nodes = interpolation_.nodes();
    for (size_t n = 0; n < nodes.size(); ++n) {  // Decoded frames go out as they are.
      weights.row(nodes[n]).setZero();
      weights(nodes[n], static_cast<Eigen::Index>(n)) = 1.0;
    }
    const auto of_frame = static_cast<int64_t>(fields_[0].nbytes());
    const int64_t chunk = std::clamp<int64_t>(kChunkBytes / of_frame, 1, kChunk);
    for (int64_t first = 0; first < landmarks_.size(0); first += chunk) {
      const int64_t count = std::min(chunk, landmarks_.size(0) - first);
      sink(first,
           interpolated(landmarks_.narrow(0, first, count), weights.middleRows(first, count)));
    }
  }

 private:
  static geometry::GreedyInterpolation points(const at::Tensor& landmarks) {
    Points points = points_of(landmarks);
    const geometry::PoseKernel kernel = kernel_of(points);
    return {std::move(points), kernel};
  }

  int64_t num_nodes() const { return static_cast<int64_t>(interpolation_.nodes().size()); }

  /// As many frames of no node, evenly over their order of doubt.
  static std::vector<int64_t> spread_over(const Eigen::VectorXd& doubt, int64_t count) {
    std::vector<int64_t> open, result;
    for (int64_t t = 0; t < doubt.size(); ++t) {
      if (doubt[t] > 0) open.push_back(t);
    }
    std::stable_sort(open.begin(), open.end(),
                     [&doubt](int64_t a, int64_t b) { return doubt[a] > doubt[b]; });
    count = std::min(count, static_cast<int64_t>(open.size()));
    for (int64_t k = 0; k < count; ++k) {
      result.push_back(
          open[open.size() * static_cast<size_t>(2 * k + 1) / static_cast<size_t>(2 * count)]);
    }
    return result;
  }

  /// Of all frames, metres, as interpolated now.
  double mean_motion() const {
    const int64_t step = std::max<int64_t>(1, fields_.size(1) / kMotionSamples);
    const at::Tensor sampled = fields_.slice(1, 0, std::nullopt, step).contiguous();
    const at::Tensor motion =
        combine_fields(interpolation_.weights(decoded()), sampled).norm(2, -1);
    return std::max(motion.mean().item<double>(), 1e-9);
  }

  /// Displacements of frames from those of the first nodes, weights (T, n), made to follow the
  /// frames' landmarks (T, 68, 3).
  at::Tensor interpolated(const at::Tensor& landmarks, const Points& weights) const {
    at::Tensor result = combine_fields(weights, fields_.narrow(0, 0, weights.cols()));
    if (const LandmarkFollower* follower = decoder_->follower()) {
      follower->add(result,
                    landmarks - combine_fields(weights, frames(0).narrow(0, 0, weights.cols())));
    }
    return result;
  }

  /// The landmarks of the nodes from this one on.
  at::Tensor frames(int64_t from) const {
    return landmarks_.index_select(
        0, at::tensor(interpolation_.nodes()).slice(0, from).to(landmarks_.device()));
  }

  at::Tensor decode(int64_t from) const { return decoder_->decode(frames(from)); }

  const LandmarkDecoder* decoder_;
  at::Tensor landmarks_, fields_;  // (T, 68, 3), (n, V, 3)
  geometry::GreedyInterpolation interpolation_;
  Errors rounding_, last_, for_doubt_;  // of the decoder; for each unit of doubt
};

}  // namespace

void AdaptiveOptions::check() const {
  FREETALK_CHECK(tolerance_mm >= 0, "STM: tolerance_mm must not be negative, found ", tolerance_mm);
  FREETALK_CHECK(tolerance_mean > 0, "STM: tolerance_mean must be positive, found ",
                 tolerance_mean);
}

void decode_adaptively(const LandmarkDecoder& decoder, const at::Tensor& landmarks,
                       const std::function<void(int64_t, const at::Tensor&)>& sink,
                       const AdaptiveOptions& options, AdaptiveReport* report,
                       const std::function<void(double)>& progress) {
  options.check();
  AdaptiveReport own;
  AdaptiveReport& found = report != nullptr ? *report : own;
  FREETALK_CHECK(
      landmarks.dim() == 3 && landmarks.size(1) == core::kNumLandmarks && landmarks.size(2) == 3,
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
  Clip clip(decoder, landmarks, options);
  const auto share = [&] {  // Clips of speech end between 40 and 100 decoded frames.
    const auto decoded = static_cast<double>(clip.decoded());
    return 0.9 * decoded / (decoded + 30.0);
  };
  clip.expect(found);
  step(share());
  for (int checks = 1; clip.check(); ++checks) {
    clip.expect(found);
    step(share());
    if (checks < kChecks) continue;
    if (found.mean_error <= options.tolerance_mean && found.max_error_mm <= options.tolerance_mm) {
      break;
    }
  }
  clip.emit([&](int64_t first, const at::Tensor& part) {
    sink(first, part);
    step(0.9 + 0.1 * static_cast<double>(first + part.size(0)) / static_cast<double>(frames));
  });
}

at::Tensor decode_adaptively(const LandmarkDecoder& decoder, const at::Tensor& landmarks,
                             const AdaptiveOptions& options, AdaptiveReport* report) {
  std::vector<at::Tensor> parts;
  decode_adaptively(
      decoder, landmarks, [&parts](int64_t, const at::Tensor& part) { parts.push_back(part); },
      options, report);
  FREETALK_CHECK(!parts.empty(), "STM: expected at least one frame");
  return at::cat(parts);
}

}  // namespace freetalk::stm
