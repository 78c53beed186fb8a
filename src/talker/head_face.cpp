#include "head_face.h"

#include <ATen/ATen.h>
#include <torch/torch.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <utility>

#include "core/smoothstep.h"
#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "freetalk/core/random.h"
#include "freetalk/head/fit.h"
#include "freetalk/head/surface.h"
#include "freetalk/head/track.h"
#include "head_decoder.h"
#include "head_lips.h"
#include "stm/lip_sides.h"

namespace freetalk::talker {
namespace {

// Motion is whole nearer to a landmark than the first (m), and none beyond the second: the skull is
// still, and the head's networks never saw a body.
constexpr double kWholeMotion = 0.08, kNoMotion = 0.14;
constexpr int64_t kFitPoints = 4000;
constexpr double kPoorFitMm = 3.0;

/// (V,) share of the head's motion that each vertex keeps.
at::Tensor reach(const Eigen::MatrixXd& vertices, const Eigen::MatrixXd& landmarks) {
  at::Tensor share = at::empty({vertices.rows()}, at::kFloat);
  auto* to = share.mutable_data_ptr<float>();
  for (Eigen::Index v = 0; v < vertices.rows(); ++v) {
    const double distance =
        std::sqrt((landmarks.rowwise() - vertices.row(v)).rowwise().squaredNorm().minCoeff());
    to[v] =
        static_cast<float>(core::smoothstep((kNoMotion - distance) / (kNoMotion - kWholeMotion)));
  }
  return share;
}

/// Vertices within the head's box, metres.
at::Tensor inside(const at::Tensor& vertices, const head::HeadOptions& options) {
  const auto corner = [&](const std::vector<double>& box) {
    return at::tensor(box).to(at::kFloat) / options.units_per_metre;
  };
  const at::Tensor kept =
      vertices.ge(corner(options.box_min)).logical_and(vertices.le(corner(options.box_max))).all(1);
  return vertices.index_select(0, kept.nonzero().squeeze(1));
}

/// Canonical points (V, 3) of vertices whose lips may touch: how far they are from their vertices
/// goes on smoothly to the rim of each lip.
at::Tensor with_lips_apart(const Face::State& face, const at::Tensor& vertices,
                           const at::Tensor& canonical) {
  const auto upper = stm::upper_side(face.follower->weights(), core::kInnerLips);
  const Eigen::RowVector3d mouth =
      face.models->face.landmarks68.bottomRows(core::kNumLandmarks - core::kFirstInnerLip)
          .colwise()
          .mean();
  const at::Tensor apart = (canonical - vertices).contiguous();
  const Eigen::MatrixXd offsets =
      Eigen::Map<const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>>(
          apart.const_data_ptr<float>(), apart.size(0), 3)
          .cast<double>();
  return vertices +
         to_tensor(continued_to_the_lips(face.parts->face_vertices(), face.parts->face_faces(),
                                         upper, mouth, offsets),
                   c10::kCPU);
}

std::string one_decimal(double value) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.1f", value);
  return text;
}

}  // namespace

void check_head(const TalkerModels& models) {
  FREETALK_CHECK(models.head,
                 "these weights hold no head/: train one with `freetalk train head` into their "
                 "folder, or leave engine at stm");
  FREETALK_CHECK(!models.rig.names.empty(),
                 "these weights hold no rig_poses.safetensors, which tells a head what it hears");
}

std::unique_ptr<const stm::LandmarkDecoder> head_of_mesh(const Face::State& face, Report& report,
                                                         const Stages& stages) {
  const head::ParametricHead& model = face.models->head;
  const at::Tensor vertices = to_tensor(face.parts->face_vertices(), c10::kCPU);
  const at::Tensor points = inside(vertices, model->options());
  FREETALK_CHECK(points.size(0) > 0, "the mesh has no vertex where a head would be");
  head::FitOptions options;
  options.points = std::min(kFitPoints, points.size(0));
  const head::Fit fit =
      head::fit_identity(model, {points}, model->rest_expression.unsqueeze(0), {}, options,
                         core::make_generator(0), [&](int64_t done, int64_t total) {
                           stages.at(static_cast<double>(done) / static_cast<double>(total));
                         });
  const double apart = fit.error_mm.mean().item<double>();
  const std::string found =
      "a head was fitted: its surface is " + one_decimal(apart) + " mm from the mesh on average";
  report.parts += "; " + found;
  if (apart > kPoorFitMm) report.notices.push_back(found + ", so its motion may not fit");
  const head::PreparedHead head(model, fit.z_id, {face.options.precision});
  at::Tensor canonical = head::canonical_template(head, vertices);
  if (face.follower) canonical = with_lips_apart(face, vertices, canonical);
  return std::make_unique<const HeadDecoder>(
      head, face.models->rig, canonical,
      reach(face.parts->face_vertices(), face.models->face.landmarks68), face.follower);
}

std::shared_ptr<const Face::State> Face::State::of_head(std::shared_ptr<const TalkerModels> models,
                                                        const at::Tensor& z_id, int64_t resolution,
                                                        const FaceOptions& options,
                                                        const Progress& progress) {
  const torch::NoGradGuard no_grad;
  options.check();
  check_head(*models);
  const auto face = std::make_shared<State>();
  face->models = models;
  face->options = options;
  face->options.engine = "head";
  face->lazy_rig = std::make_unique<LazyRig>();
  Report& report = face->report;
  Stages stages(progress, report);
  stages.begin("features");
  const head::PreparedHead head(models->head, z_id, {options.precision});
  head::SurfaceOptions finely;
  finely.resolution = resolution;
  finely.coarse = std::min(finely.coarse, resolution / 4);
  const head::Surface surface =
      head::SurfaceExtractor(head, finely)
          .extract(at::zeros({head.options().expression_dim}, at::kFloat));
  // One piece: of canonical points, whose order is that of the decoder's.
  face->parts =
      std::make_unique<animation::Parts>(surface.vertices, surface.faces, models->face.landmarks68);
  face->decoder = std::make_unique<const HeadDecoder>(
      head, models->rig, to_tensor(face->parts->face_vertices(), c10::kCPU),
      reach(face->parts->face_vertices(), models->face.landmarks68));
  const double scale = head.options().units_per_metre;
  face->rest =
      head.to_posed(to_tensor(surface.vertices, c10::kCPU) * scale, models->head->rest_expression) /
      scale;
  face->mesh.name = "head";
  face->mesh.vertices = Eigen::Map<const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>>(
                            face->rest.const_data_ptr<float>(), face->rest.size(0), 3)
                            .cast<double>();
  face->mesh.faces = surface.faces;
  face->mesh.face_polygon.resize(static_cast<size_t>(surface.faces.rows()));
  std::iota(face->mesh.face_polygon.begin(), face->mesh.face_polygon.end(), 0);
  face->to_mesh = at::eye(3, at::kFloat);
  report.alignment.unit = "m";
  report.alignment.up = "+y";
  report.alignment.forward = "+z";
  report.alignment.summary = "a parametric head, unit m, +Y up, +Z forward";
  report.alignment.face_like = true;
  report.parts = face->parts->summary();
  stages.end();
  return face;
}

}  // namespace freetalk::talker
