#include "freetalk/rig/face_rig.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "freetalk/core/torch_error.h"
#include "matrices.h"
#include "shape_solver.h"

namespace freetalk::rig {
namespace {

constexpr double kLength = 2.0;  // of the kernel, in spreads of the poses

geometry::GreedyInterpolation interpolation_of(const at::Tensor& poses) {
  Rows points = landmark_rows(poses);
  geometry::PoseKernel kernel;
  kernel.spread =
      std::max(std::sqrt(points.squaredNorm() / static_cast<double>(points.rows())), 1e-6);
  kernel.length = kLength * kernel.spread;
  geometry::GreedyInterpolation result(std::move(points), kernel);
  for (int64_t pose = 0; pose < result.num_points(); ++pose) result.add(pose);
  return result;
}

void check_landmarks(const at::Tensor& landmarks, const char* name) {
  FREETALK_CHECK(landmarks.defined() && landmarks.dim() == 3 &&
                     landmarks.size(1) == core::kNumLandmarks && landmarks.size(2) == 3,
                 "rig: ", name, " must be (N, 68, 3) landmark displacements, found ",
                 landmarks.defined() ? core::join(landmarks.sizes()) : std::string("nothing"));
}

}  // namespace

struct FaceRig::Solver {
  ShapeSolver shapes;
  geometry::GreedyInterpolation interpolation;
  Eigen::MatrixXd coefficients;  // (N, C)
  Rows shape_fields;             // (S, C)
  Rows scales;                   // (1, C)
};

void RigPoses::check() const {
  check_landmarks(shapes, "shapes");
  check_landmarks(library, "library");
  FREETALK_CHECK(static_cast<int64_t>(names.size()) == shapes.size(0), "rig: ", names.size(),
                 " names for ", shapes.size(0), " shapes");
}

void RigOptions::check() const {
  FREETALK_CHECK(num_poses >= 0, "rig: num_poses must not be negative, found ", num_poses);
  FREETALK_CHECK(max_correctives >= 0 && max_correctives <= 99,
                 "rig: max_correctives must be between 0 and 99, found ", max_correctives);
  FREETALK_CHECK(tolerance_mm >= 0, "rig: tolerance_mm must not be negative, found ", tolerance_mm);
  FREETALK_CHECK(l2 > 0, "rig: l2 must be positive, found ", l2);
  for (const auto& [name, value] : {std::pair{"l1", l1}, std::pair{"symmetry", symmetry},
                                    std::pair{"cancel", cancel}, std::pair{"temporal", temporal}}) {
    FREETALK_CHECK(value >= 0, "rig: ", name, " must not be negative, found ", value);
  }
}

void FaceRig::prepare() {
  const int64_t fields = scales_.size(0);
  FREETALK_CHECK(targets_.dim() == 3 && targets_.size(2) == 3 &&
                     targets_.size(0) == shapes_.size(0) + 2 * fields &&
                     static_cast<int64_t>(names_.size()) == targets_.size(0) &&
                     node_fields_.sizes() == at::IntArrayRef({nodes_.size(0), fields}) &&
                     shape_fields_.sizes() == at::IntArrayRef({shapes_.size(0), fields}),
                 "rig: targets, names and fields do not fit each other");
  check_landmarks(shapes_, "shapes");
  check_landmarks(nodes_, "nodes");
  geometry::GreedyInterpolation interpolation = interpolation_of(nodes_);
  FREETALK_CHECK(static_cast<int64_t>(interpolation.nodes().size()) == nodes_.size(0),
                 "rig: a pose occurs twice among the nodes");
  const std::vector<std::string> shape_names(names_.begin(), names_.begin() + shapes_.size(0));
  Eigen::MatrixXd coefficients = interpolation.coefficients(to_rows(node_fields_));
  solver_ = std::make_shared<const Solver>(
      Solver{ShapeSolver(landmark_rows(shapes_).transpose(), shape_names, options_),
             std::move(interpolation), std::move(coefficients), to_rows(shape_fields_),
             to_rows(scales_.unsqueeze(0))});
}

at::Tensor FaceRig::solve(const at::Tensor& landmarks, SolveState* state) const {
  return core::with_plain_errors("rig", [&] {
    check_landmarks(landmarks, "landmarks");
    const Rows points = landmark_rows(landmarks);
    const Rows fields = solver_->interpolation.evaluate(points, solver_->coefficients);
    const int64_t count = num_shapes(), correctives = scales_.size(0);
    SolveState own;
    std::vector<double>& weights = (state != nullptr ? *state : own).shapes;
    FREETALK_CHECK(weights.empty() || static_cast<int64_t>(weights.size()) == count,
                   "rig: the state is of another rig");
    at::Tensor result = at::empty({points.rows(), targets_.size(0)}, at::kFloat);
    float* out = result.data_ptr<float>();
    for (Eigen::Index t = 0; t < points.rows(); ++t) {
      solver_->shapes.solve(points.row(t).transpose(), weights);
      out = std::transform(weights.begin(), weights.end(), out,
                           [](double weight) { return static_cast<float>(weight); });
      const Eigen::Map<const Eigen::RowVectorXd> of_shapes(weights.data(), count);
      const Eigen::RowVectorXd left = fields.row(t) - of_shapes * solver_->shape_fields;
      for (int64_t c = 0; c < correctives; ++c) {
        const double value = left[c] / solver_->scales(0, c);
        *out++ = static_cast<float>(std::clamp(value, 0.0, 1.0));
        *out++ = static_cast<float>(std::clamp(-value, 0.0, 1.0));
      }
    }
    return result;
  });
}

at::Tensor FaceRig::vertices(const at::Tensor& weights) const {
  return core::with_plain_errors("rig", [&] {
    FREETALK_CHECK(weights.dim() == 2 && weights.size(1) == targets_.size(0),
                   "rig: weights must be (T, ", targets_.size(0), "), found ", weights.sizes());
    return geometry::combine_fields(to_rows(weights), targets_);
  });
}

}  // namespace freetalk::rig
