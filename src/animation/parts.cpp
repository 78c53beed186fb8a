#include "freetalk/animation/parts.h"

#include <ATen/ATen.h>
#include <cmath>
#include <utility>

#include "core/parallel.h"
#include "core/smoothstep.h"
#include "eyeballs.h"
#include "freetalk/animation/jaw.h"
#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "mesh/kd_tree.h"
#include "part_classes.h"

namespace freetalk::animation {
namespace {

constexpr int kNeighbours = 4;
constexpr double kRootDistance = 0.004;                   // a root lies this close to the skin
constexpr double kFarFromSkin = 0.06, kNearSkin = 0.015;  // m, between them following fades out
constexpr double kFarFromRoot = 0.10, kNearRoot = 0.03;
constexpr double kEyeball = 0.025;  // m from the middle of an eye's landmarks to that of its ball

using Weights = std::vector<std::pair<int, double>>;

/// Inverse squared distance weights over the nearest skin vertices.
Weights follow_skin(const std::vector<mesh::Neighbour>& skin) {
  Weights weights;
  if (skin.empty()) return weights;
  double sum = 0;
  for (const auto& [index, distance] : skin) {
    const double weight = 1 / (distance * distance + 0.0005 * 0.0005);
    weights.emplace_back(index, weight);
    sum += weight;
  }
  const double share = core::fade(skin.front().distance, kNearSkin, kFarFromSkin) / sum;
  for (auto& [index, weight] : weights) weight *= share;
  return weights;
}

/// Binds the vertices of one part: those near the skin to it, the others to the part's own nearest
/// root.
void bind_part(const Eigen::MatrixXd& vertices, const std::vector<int>& members,
               const mesh::KdTree& skin, std::vector<Weights>& rows) {
  std::vector<int> roots, others;
  for (const int v : members) {
    const auto near = skin.nearest(vertices.row(v), kNeighbours, kFarFromSkin);
    rows[v] = follow_skin(near);
    (!near.empty() && near.front().distance < kRootDistance ? roots : others).push_back(v);
  }
  if (roots.empty()) return;
  Eigen::Matrix3Xd points(3, roots.size());
  for (size_t i = 0; i < roots.size(); ++i) points.col(i) = vertices.row(roots[i]);
  const mesh::KdTree tree(points);
  for (const int v : others) {
    const auto root = tree.nearest(vertices.row(v), 1, kFarFromRoot);
    rows[v].clear();
    if (root.empty()) continue;
    rows[v] = rows[roots[root.front().index]];
    for (auto& [index, weight] : rows[v]) {
      weight *= core::fade(root.front().distance, kNearRoot, kFarFromRoot);
    }
  }
}

Binding pack(const std::vector<Weights>& rows) {
  Binding binding;
  binding.starts.push_back(0);
  for (const auto& row : rows) {
    for (const auto& [index, weight] : row) {
      if (weight == 0) continue;
      binding.indices.push_back(index);
      binding.weights.push_back(static_cast<float>(weight));
    }
    binding.starts.push_back(static_cast<int64_t>(binding.indices.size()));
  }
  return binding;
}

}  // namespace

Parts::Parts(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
             const Eigen::MatrixXd& landmarks)
    : vertices_(vertices), landmarks_(landmarks) {
  FREETALK_CHECK(landmarks.rows() == core::kNumLandmarks && landmarks.cols() == 3,
                 "Parts: landmarks must be (68, 3), found (", landmarks.rows(), ", ",
                 landmarks.cols(), ")");
  const Welded welded = weld_seams(vertices, faces);
  const auto members = component_members(welded);
  const auto motions = classify_parts(vertices, welded, landmarks);
  part_of_vertex_ = welded.component;
  jaw_share_ = jaw_shares(vertices, welded, motions, landmarks);
  for (int c = 0; c < welded.num_components; ++c) {
    parts_.push_back({motions[c], static_cast<int64_t>(members[c].size())});
  }
  const auto is_face = [&](int v) { return motions[welded.component[v]] == PartMotion::kFace; };

  std::vector<int> compact(vertices.rows(), -1);
  int64_t count = 0;
  for (int64_t v = 0; v < vertices.rows(); ++v) {
    const int first = welded.representative[v];
    if (!is_face(v)) continue;
    compact[v] = first == v ? static_cast<int>(count++) : compact[first];
  }
  face_vertices_.resize(count, 3);
  for (int64_t v = 0; v < vertices.rows(); ++v) {
    if (compact[v] >= 0 && welded.representative[v] == v) {
      face_vertices_.row(compact[v]) = vertices.row(v);
    }
  }
  std::vector<int64_t> kept;
  for (int64_t f = 0; f < faces.rows(); ++f) {
    if (is_face(faces(f, 0))) kept.push_back(f);
  }
  face_faces_.resize(static_cast<int64_t>(kept.size()), 3);
  for (size_t i = 0; i < kept.size(); ++i) {
    for (int k = 0; k < 3; ++k) face_faces_(i, k) = compact[faces(kept[i], k)];
  }

  std::vector<Eyeball> eyeballs;
  std::vector<Weights> rows(vertices.rows());
  for (int64_t v = 0; v < vertices.rows(); ++v) {
    if (compact[v] >= 0) rows[v] = {{compact[v], 1.0}};
  }
  const mesh::KdTree skin(face_vertices_.transpose());
  for (int c = 0; c < welded.num_components; ++c) {
    if (motions[c] == PartMotion::kSurface) bind_part(vertices, members[c], skin, rows);
  }
  binding_ = pack(rows);
  for (const int first : {36, 42}) {
    const Eigen::RowVector3d eye = landmarks.middleRows(first, 6).colwise().mean();
    std::vector<bool> ball(vertices.rows());
    for (int c = 0; c < welded.num_components; ++c) {
      const Eigen::RowVector3d middle = vertices(members[c], Eigen::all).colwise().mean();
      if (motions[c] != PartMotion::kStill || (middle - eye).norm() > kEyeball) continue;
      for (const int v : members[c]) ball[v] = true;
    }
    const auto points = dense_points(vertices, faces, ball);
    if (points.rows() > 0) eyeballs.emplace_back(points, face_vertices_);
  }
  eyeballs_ = std::make_shared<const std::vector<Eyeball>>(std::move(eyeballs));
}

at::Tensor Parts::move(const at::Tensor& face_displacements, const at::Tensor& landmarks) const {
  const int64_t skin = face_vertices_.rows(), total = vertices_.rows();
  FREETALK_CHECK(face_displacements.dim() == 3 && face_displacements.size(1) == skin &&
                     face_displacements.size(2) == 3,
                 "Parts: expected skin displacements (t, ", skin, ", 3), found ",
                 face_displacements.sizes());
  const int64_t frames = face_displacements.size(0);
  FREETALK_CHECK(landmarks.dim() == 3 && landmarks.size(0) == frames, "Parts: expected landmarks (",
                 frames, ", 68, 3), found ", landmarks.sizes());
  auto source = face_displacements.to(at::kCPU, at::kFloat).contiguous();
  if (!eyeballs_->empty() && source.is_alias_of(face_displacements)) source = source.clone();
  const auto jaw = fit_jaw(landmarks_, landmarks);
  auto result = at::empty({frames, total, 3}, at::kFloat);
  float* from = source.data_ptr<float>();
  float* to = result.data_ptr<float>();
  core::parallel_for(0, frames, 1, [&](int64_t begin, int64_t end) {
    for (int64_t t = begin; t < end; ++t) {
      for (const Eyeball& ball : *eyeballs_) ball.keep_out(from + 3 * t * skin);
      for (int64_t v = 0; v < total; ++v) {
        Eigen::Vector3f sum = Eigen::Vector3f::Zero();
        for (int64_t k = binding_.starts[v]; k < binding_.starts[v + 1]; ++k) {
          sum += binding_.weights[k] *
                 Eigen::Map<const Eigen::Vector3f>(from + 3 * (t * skin + binding_.indices[k]));
        }
        if (jaw_share_[v] > 0) {
          const Eigen::Vector3d rest = vertices_.row(v);
          const Eigen::Vector3d moved = jaw[t].rotation * rest + jaw[t].translation - rest;
          sum += jaw_share_[v] * moved.cast<float>();
        }
        Eigen::Map<Eigen::Vector3f>(to + 3 * (t * total + v)) = sum;
      }
    }
  });
  return result;
}

std::string Parts::summary() const {
  int64_t counts[4] = {0, 0, 0, 0};
  for (const auto& part : parts_) counts[static_cast<int>(part.motion)] += part.num_vertices;
  const char* names[4] = {"skin", "following the skin", "with the jaw", "still"};
  std::string text;
  for (int i = 0; i < 4; ++i) {
    if (counts[i] == 0) continue;
    text += (text.empty() ? "" : ", ") + std::to_string(counts[i]) + " " + names[i];
  }
  return text + " (vertices)";
}

}  // namespace freetalk::animation
