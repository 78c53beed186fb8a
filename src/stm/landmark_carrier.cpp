#include "freetalk/stm/landmark_carrier.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "core/smoothstep.h"
#include "freetalk/core/error.h"
#include "stm/gap_cut.h"
#include "stm/lip_sides.h"

namespace freetalk::stm {
namespace {

using core::kInnerLips;
using core::kLids;
using core::kNumLandmarks;
using core::smoothstep;
using Frame = at::TensorAccessor<float, 2>;

constexpr double kClosed = 4e-4;        // c, m
constexpr double kPress = 1.5e-4;       // p, m
constexpr double kRelease = 3.0;        // r, of what is closed; above 1.5 the order of gaps is kept
constexpr double kLeastRelease = 3e-3;  // r, m, at least
constexpr double kWidest = 0.008;       // m: lips that are farther apart at rest close by this
constexpr double kUpperMost = 7.5e-4;   // m
constexpr double kChinShare = 0.6;      // of what the lower lip closes beyond that
constexpr double kShut = 0.08, kAjar = 0.3;  // e and where leading starts, of the eye's opening
// What is left of a closed lid's way by a surface that follows its landmarks closely, not exactly.
constexpr double kLidPress = 0.02;   // of the eye's opening, where it is not measured
constexpr double kLidLeft = 1.2e-4;  // m: lids of a closed eye may be this far apart between the
constexpr double kLidPast = 5.5e-4;  // landmarks; and pass each other by this at them
constexpr double kLidMost = 1.5e-3;  // m that a lid goes beyond where its landmarks meet, or stops
constexpr double kFacing = 0.5;      // of the landmarks' distance: rims that are nearer are none
constexpr double kOpen = 1e-3;       // m: an eye whose rims are nearer is closed at rest
constexpr int kLidRounds = 4;
constexpr double kNarrowest = 0.75, kBroadest = 1.3;  // of the mean mouth's width
constexpr int kChin = 6, kChinEnd = 11, kMouth = 48;

/// Opening of a pair in a frame.
template <class Pair>
double opening(const Frame& frame, const Pair& pair) {
  return frame[pair[0]][1] - frame[pair[1]][1];
}

/// See the header.
double carried_lips(double o, double s) {
  const double closed = s + kClosed;
  const double release = std::max(kRelease * closed, kLeastRelease);
  return std::max(o - closed * (1 - smoothstep((o - kClosed) / release)), -s - kPress);
}

/// 0 for open lids, 1 for shut ones. @param share of the eye's opening that is left.
double closing_of(double share) {
  return 1 - smoothstep((std::max(0.0, share) - kShut) / (kAjar - kShut));
}

}  // namespace

/// The rims of lids in a plane.
class LandmarkCarrier::Rims {
 public:
  Rims(const GapCut& cut, const Eigen::MatrixXi& faces, double of_landmarks) : faces_(faces) {
    if (auto found = cut.nearest()) {
      apart_ = (*found)[0].at - (*found)[1].at;
      if (apart_.norm() > std::max(kFacing * of_landmarks, kOpen)) spots_ = found;
    }
  }

  bool known() const { return spots_.has_value(); }

  /// m that the upper rim is above the lower one, along the line between them at rest.
  double gap(const at::TensorAccessor<float, 3>& moved) const {
    const auto& [upper, lower] = *spots_;
    const Eigen::RowVector3d now =
        apart_ + upper.displacement(faces_, moved) - lower.displacement(faces_, moved);
    return now.dot(apart_.normalized());
  }

 private:
  const Eigen::MatrixXi& faces_;
  Eigen::RowVector3d apart_ = Eigen::RowVector3d::Zero();
  std::optional<std::array<Spot, 2>> spots_;
};

LandmarkCarrier::LandmarkCarrier(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                 const LandmarkFollower& follower, const Eigen::MatrixXd& mean,
                                 bool known, const LandmarkDecoder* decoder) {
  FREETALK_CHECK(mean.rows() == kNumLandmarks && mean.cols() == 3,
                 "STM: expected the mean face's landmarks (68, 3), found (", mean.rows(), ", ",
                 mean.cols(), ")");
  const at::Tensor weights = follower.weights().to(at::kCPU);
  FREETALK_CHECK(weights.size(0) == vertices.rows(), "STM: the follower is of ", weights.size(0),
                 " vertices, the surface of ", vertices.rows());
  const at::Tensor corners = follower.corners().to(at::kCPU);
  const at::Tensor shares = follower.shares().to(at::kCPU);
  const auto corner = corners.accessor<int64_t, 2>();
  const auto share = shares.accessor<float, 2>();
  const auto place = [&](int n) {
    Eigen::RowVector3d sum = Eigen::RowVector3d::Zero();
    for (int k = 0; k < 3; ++k) sum += share[n][k] * vertices.row(corner[n][k]);
    return sum;
  };
  const auto clearance = [&](const std::vector<bool>& upper, const auto& pair) {
    return GapCut(vertices, faces, upper, place(pair[0]), place(pair[1])).clearance();
  };
  const auto lips = upper_side(weights, kInnerLips), lids = upper_side(weights, kLids);
  for (size_t i = 0; i < kInnerLips.size(); ++i) {
    lips_[i] = std::min(clearance(lips, kInnerLips[i]).value_or(0.0), kWidest);
  }
  for (size_t i = 0; i < kLids.size(); ++i) {
    const auto [upper, lower] = kLids[i];
    mean_gap_[i] = (mean.row(upper) - mean.row(lower)).transpose();
    const auto found = clearance(lids, kLids[i]);
    // Guessed landmarks that are joined may lie on one lid.
    const bool told = found && (known || *found > 0);
    lids_[i] = told ? *found : mean_gap_[i].norm();
    own_gap_[i] = (place(upper) - place(lower)).transpose();
    own_gap_[i] = lids_[i] * (told ? own_gap_[i] : mean_gap_[i]).normalized();
    lid_press_[i] = kLidPress * lids_[i];
  }
  if (known) {
    width_ = (place(54)[0] - place(48)[0]) / (mean(54, 0) - mean(48, 0));
    width_ = std::clamp(width_, kNarrowest, kBroadest);
  }
  if (decoder == nullptr) return;
  // The rims of an eye in the planes of its two pairs and between them.
  const auto rims = [&](const Eigen::RowVector3d& top, const Eigen::RowVector3d& bottom) {
    return Rims(GapCut(vertices, faces, lids, top, bottom), faces, (top - bottom).norm());
  };
  std::vector<Rims> at, between;
  for (size_t i = 0; i < kLids.size(); ++i) {
    const auto [upper, lower] = kLids[i];
    at.push_back(rims(place(upper), place(lower)));
    if (i % 2 == 0) {
      const auto [next_upper, next_lower] = kLids[i + 1];
      between.push_back(
          rims((place(upper) + place(next_upper)) / 2, (place(lower) + place(next_lower)) / 2));
    }
  }
  close_lids(*decoder, at, between);
}

void LandmarkCarrier::close_lids(const LandmarkDecoder& decoder, const std::vector<Rims>& at,
                                 const std::vector<Rims>& between) {
  const LandmarkDecoder& fast = decoder.fastest();
  at::Tensor closed = at::zeros({1, kNumLandmarks, 3});
  auto frame = closed.accessor<float, 3>()[0];
  for (size_t i = 0; i < kLids.size(); ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      frame[kLids[i][0]][axis] = static_cast<float>(-mean_gap_[i][axis]);
    }
  }
  std::array<double, kLids.size() / 2> pasts{};
  for (int round = 0; round < kLidRounds; ++round) {
    const at::Tensor decoded = fast.decode(apply(closed)).to(at::kCPU, at::kFloat);
    const auto moved = decoded.accessor<float, 3>();
    for (size_t eye = 0; eye < between.size(); ++eye) {
      const size_t first = 2 * eye, second = first + 1;
      if (!at[first].known() || !at[second].known()) continue;
      const double gaps[] = {at[first].gap(moved), at[second].gap(moved)};
      double& past = pasts[eye];
      if (between[eye].known()) {
        // What would be left between landmarks that pass each other by as much as before.
        const double left = between[eye].gap(moved) - (gaps[0] + gaps[1]) / 2 - past;
        past = std::clamp(past + left - kLidLeft, 0.0, kLidPast);
      }
      for (size_t k = 0; k < 2; ++k) {
        double& press = lid_press_[first + k];
        press = std::clamp(press + gaps[k] + past, -kLidMost, kLidMost);
      }
    }
  }
}

at::Tensor LandmarkCarrier::apply(const at::Tensor& landmarks) const {
  FREETALK_CHECK(
      landmarks.dim() == 3 && landmarks.size(1) == kNumLandmarks && landmarks.size(2) == 3,
      "STM: expected landmarks (T, 68, 3), found ", landmarks.sizes());
  at::Tensor result = landmarks
                          .to(at::TensorOptions(at::kCPU).dtype(at::kFloat),
                              /*non_blocking=*/false, /*copy=*/true)
                          .contiguous();
  auto frames = result.accessor<float, 3>();
  for (int64_t t = 0; t < frames.size(0); ++t) {
    Frame frame = frames[t];
    for (int n = kMouth; n < kNumLandmarks; ++n) frame[n][0] *= static_cast<float>(width_);
    for (size_t i = 0; i < kLids.size(); ++i) {
      const auto [upper, lower] = kLids[i];
      const Eigen::Vector3d& mean = mean_gap_[i];
      const double scale = lids_[i] / mean.norm();
      Eigen::Vector3d apart;
      for (int axis = 0; axis < 3; ++axis) apart[axis] = frame[upper][axis] - frame[lower][axis];
      const double q = apart.dot(mean) / mean.squaredNorm();
      const double closing = closing_of(1 + q);
      const double left = q >= -1 ? (1 + q) * (1 - closing) : 0;
      const Eigen::Vector3d wanted = (left - 1) * own_gap_[i] -
                                     closing * lid_press_[i] * own_gap_[i].normalized() +
                                     scale * (apart - q * mean);
      for (int axis = 0; axis < 3; ++axis) {
        frame[lower][axis] *= static_cast<float>(scale);
        frame[upper][axis] = frame[lower][axis] + static_cast<float>(wanted[axis]);
      }
    }
    std::array<double, kInnerLips.size()> upper{}, lower{};
    double chin = 0;
    for (size_t i = 0; i < kInnerLips.size(); ++i) {
      const double own = opening(frame, kInnerLips[i]);
      const double change = carried_lips(own, lips_[i]) - own;
      upper[i] = std::max(change / 2, -kUpperMost);
      lower[i] = upper[i] - change;
      chin += kChinShare * std::max(0.0, lower[i] - kUpperMost) / kInnerLips.size();
    }
    for (const auto& [n, pair] : core::kUpperLip) frame[n][1] += static_cast<float>(upper[pair]);
    for (const auto& [n, pair] : core::kLowerLip) frame[n][1] += static_cast<float>(lower[pair]);
    for (int n = kChin; n < kChinEnd; ++n) frame[n][1] += static_cast<float>(chin);
  }
  return result;
}

}  // namespace freetalk::stm
