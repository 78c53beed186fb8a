// Making a rig: shapes and poses decoded, what the shapes leave over in principal fields.
#include <ATen/ATen.h>
#include <Eigen/Eigenvalues>

#include <algorithm>
#include <cmath>

#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "freetalk/core/torch_error.h"
#include "freetalk/rig/face_rig.h"
#include "matrices.h"
#include "shape_solver.h"

namespace freetalk::rig {
namespace {

constexpr int64_t kBatch = 32;     // frames decoded between two reports of progress
constexpr double kHeadroom = 1.5;  // of a corrective's range over that among the poses
constexpr double kSamePose = 0.1;  // mm over all landmarks

/// Rest, shapes and library, without poses that are there already.
at::Tensor candidates(const RigPoses& poses, int64_t limit) {
  const int64_t count = std::min(limit, poses.library.size(0));
  const at::Tensor all =
      at::cat({at::zeros({1, core::kNumLandmarks, 3}), poses.shapes.to(at::kCPU, at::kFloat),
               poses.library.narrow(0, 0, count).to(at::kCPU, at::kFloat)});
  const Rows rows = landmark_rows(all);
  std::vector<int64_t> kept;
  for (int64_t i = 0; i < rows.rows(); ++i) {
    const bool known = std::any_of(kept.begin(), kept.end(), [&](int64_t k) {
      return (rows.row(i) - rows.row(k)).norm() < kSamePose;
    });
    const bool is_shape = i > 0 && i <= poses.shapes.size(0);
    FREETALK_CHECK(!known || !is_shape, "rig: shape ",
                   poses.names[static_cast<size_t>(std::max<int64_t>(i - 1, 0))],
                   " moves no landmark, or moves them as another does");
    if (!known) kept.push_back(i);
  }
  return all.index_select(0, at::tensor(kept));
}

at::Tensor decode_all(const FaceRig::Decode& decode, const at::Tensor& poses,
                      const std::function<void(double)>& progress) {
  std::vector<at::Tensor> parts;
  const int64_t count = poses.size(0);
  for (int64_t first = 0; first < count; first += kBatch) {
    const int64_t size = std::min(kBatch, count - first);
    parts.push_back(decode(poses.narrow(0, first, size)).to(at::kCPU, at::kFloat).contiguous());
    const at::Tensor& part = parts.back();
    FREETALK_RUNTIME_CHECK(part.dim() == 3 && part.size(0) == size && part.size(2) == 3,
                           "rig: decoding ", size, " poses gave ", part.sizes(),
                           " instead of (N, V, 3)");
    FREETALK_RUNTIME_CHECK(at::isfinite(part).all().item<bool>(),
                           "rig: decoding gave values that are not finite");
    if (progress) progress(0.95 * static_cast<double>(first + size) / static_cast<double>(count));
  }
  return at::cat(parts);
}

/// Principal fields of what is left over, orthonormal, until the root mean square of what they
/// leave in turn is below the tolerance.
at::Tensor principal_fields(const at::Tensor& left, const RigOptions& options) {
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solved(products(left, left));
  const auto count = static_cast<double>(left.size(0) * left.size(1));
  double energy = solved.eigenvalues().cwiseMax(0.0).sum();
  std::vector<Eigen::Index> chosen;
  for (Eigen::Index i = left.size(0) - 1; i >= 0; --i) {
    const double value = solved.eigenvalues()[i];
    const bool enough = 1e3 * std::sqrt(std::max(energy, 0.0) / count) <= options.tolerance_mm;
    if (enough || value <= 1e-12 * solved.eigenvalues().maxCoeff() ||
        static_cast<int64_t>(chosen.size()) == options.max_correctives) {
      break;
    }
    chosen.push_back(i);
    energy -= value;
  }
  Rows weights(chosen.size(), left.size(0));
  for (size_t c = 0; c < chosen.size(); ++c) {
    Eigen::VectorXd mode = solved.eigenvectors().col(chosen[c]);
    Eigen::Index largest = 0;
    mode.cwiseAbs().maxCoeff(&largest);
    if (mode[largest] < 0) mode = -mode;  // Eigenvectors have no sign of their own.
    weights.row(static_cast<Eigen::Index>(c)) =
        mode.transpose() / std::sqrt(solved.eigenvalues()[chosen[c]]);
  }
  return geometry::combine_fields(weights, left);
}

std::string numbered(int64_t index, const char* sign) {
  const std::string digits = std::to_string(index);
  return "corrective_" + std::string(digits.size() < 2 ? "0" : "") + digits + "_" + sign;
}

}  // namespace

FaceRig FaceRig::build(const Decode& decode, const RigPoses& poses, const RigOptions& options,
                       const std::function<void(double)>& progress) {
  return core::with_plain_errors("rig", [&] {
    options.check();
    poses.check();
    const at::NoGradGuard no_grad;
    FaceRig rig;
    rig.options_ = options;
    rig.names_ = poses.names;
    rig.shapes_ = poses.shapes.to(at::kCPU, at::kFloat).contiguous();
    rig.nodes_ = candidates(poses, options.num_poses);
    const int64_t shapes = rig.shapes_.size(0);
    const at::Tensor decoded = decode_all(decode, rig.nodes_, progress);
    const at::Tensor targets = decoded.narrow(0, 1, shapes);

    const ShapeSolver solver(landmark_rows(rig.shapes_).transpose(), rig.names_, options);
    const Rows points = landmark_rows(rig.nodes_);
    Rows weights(points.rows(), shapes);
    for (Eigen::Index n = 0; n < points.rows(); ++n) {
      std::vector<double> of_pose;
      solver.solve(points.row(n).transpose(), of_pose);
      weights.row(n) = Eigen::Map<const Eigen::RowVectorXd>(of_pose.data(), shapes);
    }
    const at::Tensor fields =
        principal_fields(decoded - geometry::combine_fields(weights, targets), options);
    const int64_t count = fields.size(0);
    Rows node_fields(points.rows(), count), shape_fields(shapes, count);
    if (count > 0) {
      node_fields = products(decoded, fields);
      shape_fields = products(targets, fields);
    }
    const Rows range = (node_fields - weights * shape_fields).cwiseAbs().colwise().maxCoeff();
    rig.node_fields_ = to_tensor(node_fields);
    rig.shape_fields_ = to_tensor(shape_fields);
    rig.scales_ = to_tensor(kHeadroom * range.cwiseMax(1e-9)).flatten();

    std::vector<at::Tensor> all = {targets};
    for (int64_t c = 0; c < count; ++c) {
      const at::Tensor field = fields[c] * rig.scales_[c].item<double>();
      all.push_back(at::stack({field, -field}));
      rig.names_.push_back(numbered(c, "plus"));
      rig.names_.push_back(numbered(c, "minus"));
    }
    rig.targets_ = at::cat(all).contiguous();
    rig.prepare();
    if (progress) progress(1.0);
    return rig;
  });
}

}  // namespace freetalk::rig
