#include "freetalk/stm/landmark_follower.h"

#include <ATen/ATen.h>

#include <cmath>
#include <vector>

#include "core/parallel.h"
#include "core/smoothstep.h"
#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "geometry/tensor_conversion.h"
#include "stm/lid_rims.h"
#include "stm/lip_sides.h"

namespace freetalk::stm {
namespace {

using core::kNumLandmarks;

constexpr int64_t kTogether = 8;  // frames of a product

/// (V, 1) m from each vertex to the nearest landmark.
Eigen::MatrixXd distances_of(const Eigen::MatrixXd& vertices, const Eigen::MatrixXd& landmarks) {
  Eigen::MatrixXd distances(vertices.rows(), 1);
  for (Eigen::Index v = 0; v < vertices.rows(); ++v) {
    distances(v, 0) =
        std::sqrt((landmarks.rowwise() - vertices.row(v)).rowwise().squaredNorm().minCoeff());
  }
  return distances;
}

}  // namespace

void FollowOptions::check() const {
  kriging.check();
  FREETALK_CHECK(farthest > 0, "STM: farthest must be positive, found ", farthest);
  FREETALK_CHECK(detail >= 0 && coarsest >= 0 && finest >= 0,
                 "STM: detail, coarsest and finest must not be negative, found ", detail, ", ",
                 coarsest, " and ", finest);
  FREETALK_CHECK(near >= 0 && far > near, "STM: far must be above near, found ", far, " and ",
                 near);
}

LandmarkFollower::LandmarkFollower(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                   const Eigen::MatrixXd& landmarks, const Eigen::MatrixXd& normals,
                                   const FollowOptions& options) {
  options.check();
  FREETALK_CHECK(landmarks.rows() == kNumLandmarks && landmarks.cols() == 3,
                 "STM: expected landmarks (68, 3), found (", landmarks.rows(), ", ",
                 landmarks.cols(), ")");
  auto places = geometry::nearest_on_surface(vertices, faces, landmarks, normals);
  put_on_their_lips(vertices, faces, landmarks, normals, places);
  if (options.guessed) put_on_their_lids(vertices, faces, landmarks, places);
  std::vector<Eigen::Index> near;
  for (Eigen::Index n = 0; n < kNumLandmarks; ++n) {
    if (places.distance[n] <= options.farthest) near.push_back(n);
  }
  num_followed_ = static_cast<int64_t>(near.size());
  Eigen::MatrixXd weights = Eigen::MatrixXd::Zero(vertices.rows(), kNumLandmarks);
  if (!near.empty()) {
    weights(Eigen::all, near) = geometry::kriging_weights(
        vertices, faces,
        {places.corners(near, Eigen::all), places.shares(near, Eigen::all), places.distance(near)},
        options.kriging);
  }
  const auto plain = [](const Eigen::MatrixXd& matrix) {
    return geometry::to_tensor(matrix).to(at::kFloat);
  };
  corners_ = geometry::to_tensor(places.corners.cast<double>()).to(at::kLong);
  shares_ = plain(places.shares);
  weights_ = plain(weights);
  const Eigen::MatrixXd distances = distances_of(vertices, landmarks);
  reach_ = plain(
      distances.unaryExpr([&](double d) { return core::fade(d, options.near, options.far); }));
  const Eigen::MatrixXd lengths =
      (options.detail * distances).cwiseMin(options.coarsest).cwiseMax(options.finest);
  lengths_ = plain(lengths);
  if (lengths.maxCoeff() > 0) low_pass_.emplace(vertices, faces, lengths.col(0));
}

at::Tensor LandmarkFollower::apply(const at::Tensor& displacements,
                                   const at::Tensor& landmarks) const {
  FREETALK_CHECK(displacements.dim() == 3 && displacements.size(1) == weights_.size(0) &&
                     displacements.size(2) == 3,
                 "STM: expected displacements (T, ", weights_.size(0), ", 3), found ",
                 displacements.sizes());
  FREETALK_CHECK(landmarks.dim() == 3 && landmarks.size(0) == displacements.size(0) &&
                     landmarks.size(1) == kNumLandmarks && landmarks.size(2) == 3,
                 "STM: expected landmarks (", displacements.size(0), ", 68, 3), found ",
                 landmarks.sizes());
  const at::Tensor smooth = low_pass_ ? low_pass_->apply(displacements) : displacements;
  const at::Tensor there = smooth.index_select(1, corners_.flatten())
                               .view({-1, kNumLandmarks, 3, 3})
                               .mul(shares_.unsqueeze(-1))
                               .sum(2);  // (T, 68, 3)
  return reach_ * (smooth + at::matmul(weights_, landmarks - there));
}

at::Tensor LandmarkFollower::apply_frames(const at::Tensor& displacements,
                                          const at::Tensor& landmarks) const {
  if (!displacements.is_cpu()) return apply(displacements, landmarks);
  at::Tensor result = at::empty_like(displacements);
  core::parallel_for(0, landmarks.size(0), 1, [&](int64_t begin, int64_t end) {
    for (int64_t t = begin; t < end; ++t) {
      result.narrow(0, t, 1).copy_(apply(displacements.narrow(0, t, 1), landmarks.narrow(0, t, 1)));
    }
  });
  return result;
}

void LandmarkFollower::add(const at::Tensor& displacements, const at::Tensor& differences) const {
  const int64_t frames = displacements.size(0), vertices = displacements.size(1);
  core::parallel_for(0, (frames + kTogether - 1) / kTogether, 1, [&](int64_t begin, int64_t end) {
    for (int64_t first = kTogether * begin; first < std::min(frames, kTogether * end);
         first += kTogether) {
      const int64_t count = std::min(kTogether, frames - first);
      const at::Tensor told = differences.narrow(0, first, count).transpose(0, 1).flatten(1);
      const at::Tensor spread = (reach_ * at::mm(weights_, told)).view({vertices, count, 3});
      displacements.narrow(0, first, count).add_(spread.transpose(0, 1));
    }
  });
}

LandmarkFollower LandmarkFollower::to(const c10::Device& device) const {
  LandmarkFollower result = *this;
  for (auto* tensor :
       {&result.corners_, &result.shares_, &result.weights_, &result.reach_, &result.lengths_}) {
    *tensor = tensor->to(device);
  }
  return result;
}

}  // namespace freetalk::stm
