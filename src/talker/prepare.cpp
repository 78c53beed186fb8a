#include <ATen/ATen.h>
#include <torch/torch.h>

#include <Eigen/Geometry>

#include <algorithm>

#include "core/scratch.h"
#include "face_state.h"
#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "freetalk/geometry/operators.h"
#include "freetalk/mesh/lip_slit.h"
#include "freetalk/stm/frame_decoder.h"
#include "head_face.h"
#include "stages.h"

namespace freetalk::talker {
namespace {

/// Noise (see geometry::KrigingOptions) of landmarks that are taken where the mean face has them.
constexpr double kUncertain = 0.05;

Eigen::Vector3d axis(const std::string& name) {
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();
  direction[name.at(1) - 'x'] = name.at(0) == '-' ? -1 : 1;
  return direction;
}

animation::MeshFrame frame_of(const geometry::Alignment& alignment) {
  animation::MeshFrame frame;
  const Eigen::Vector3d up = axis(alignment.up), forward = axis(alignment.forward);
  frame.to_y_up.row(0) = up.cross(forward);
  frame.to_y_up.row(1) = up;
  frame.to_y_up.row(2) = forward;
  frame.metres_per_unit = alignment.to_canonical.scale;
  for (const core::Unit& unit : core::kUnits) {
    if (alignment.unit == unit.name) frame.metres_per_unit = unit.metres;
  }
  return frame;
}

/// Operators with exactly `k` eigenpairs: a mesh of fewer vertices is completed with empty ones.
geometry::SurfaceOperators operators_of(const Eigen::MatrixXd& vertices,
                                        const Eigen::MatrixXi& faces, int64_t k,
                                        const std::optional<std::string>& cache_dir,
                                        const std::string& name,
                                        const std::function<void(double)>& progress) {
  geometry::OperatorOptions options;
  options.k_eig = std::min<int64_t>(k, vertices.rows());
  constexpr int64_t kMaxCacheBytes = int64_t{4} << 30;
  auto operators = cache_dir
                       ? geometry::cached_surface_operators(vertices, faces, options,
                                                            *cache_dir == "auto" ? "" : *cache_dir,
                                                            name, kMaxCacheBytes, progress)
                       : geometry::surface_operators(vertices, faces, options, name, progress);
  const int64_t missing = k - options.k_eig;
  if (missing > 0) {
    operators.evals = at::cat({operators.evals, operators.evals.slice(0, -1).expand({missing})});
    operators.evecs = at::constant_pad_nd(operators.evecs, {0, missing});
  }
  return operators;
}

}  // namespace

at::Tensor to_tensor(const Eigen::MatrixXd& matrix, const c10::Device& device) {
  const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> rows = matrix;
  return at::from_blob(const_cast<double*>(rows.data()), {rows.rows(), rows.cols()}, at::kDouble)
      .to(device, at::kFloat, /*non_blocking=*/false, /*copy=*/true);
}

std::shared_ptr<const Face::State> Face::State::prepare(std::shared_ptr<const TalkerModels> models,
                                                        c10::Device device, const mesh::Mesh& mesh,
                                                        const FaceOptions& options,
                                                        const Progress& progress,
                                                        const Eigen::MatrixXd& landmarks) {
  const torch::NoGradGuard no_grad;
  options.check();
  FREETALK_CHECK(
      landmarks.size() == 0 || (landmarks.rows() == core::kNumLandmarks && landmarks.cols() == 3),
      "landmarks must be (68, 3), found (", landmarks.rows(), ", ", landmarks.cols(), ")");
  if (options.engine == "head") check_head(*models);
  const auto face = std::make_shared<State>();
  face->models = models;
  face->device = device;
  face->mesh = mesh;
  face->options = options;
  face->lazy_rig = std::make_unique<LazyRig>();
  Report& report = face->report;
  Stages stages(progress, report);

  stages.begin("align");
  report.alignment = geometry::align_to_template(mesh.vertices, mesh.faces, models->face.points,
                                                 models->face.normals,
                                                 {options.unit, options.up, options.forward});
  if (!report.alignment.face_like) {
    report.notices.push_back(core::join(report.alignment.summary,
                                        report.alignment.guessed
                                            ? ": give unit, up and forward if the guess is wrong"
                                            : ": check the unit, up and forward that were given"));
  }
  face->frame = frame_of(report.alignment);
  const auto& pose = report.alignment.to_canonical;
  face->rest = to_tensor(mesh.vertices, c10::kCPU);
  face->to_mesh = to_tensor(pose.rotation / pose.scale, c10::kCPU);  // rows: d R / s

  stages.begin("parts");
  face->parts = std::make_unique<animation::Parts>(pose.apply(mesh.vertices), mesh.faces,
                                                   models->face.landmarks68);
  report.parts = face->parts->summary();

  const bool known = landmarks.size() > 0;
  const Eigen::MatrixXd marks =
      known ? Eigen::MatrixXd(pose.apply(landmarks)) : models->face.landmarks68;
  if (mesh::lips_are_joined(face->parts->face_vertices(), face->parts->face_faces(), marks)) {
    report.notices.push_back(
        "the lips are one closed skin, which stretches where a mouth should open: 'freetalk mesh "
        "prepare' cuts them apart");
  }
  if (options.engine == "head") {
    stages.begin("features");
    face->follow(marks, known, /*usually=*/true, c10::kCPU);
    face->decoder = head_of_mesh(*face, report, stages);
  } else {
    face->decode_by_stm(marks, known, stages);
  }
  if (face->follower) {
    const auto* seen = options.engine == "head" ? nullptr : face->decoder.get();
    face->carrier = std::make_unique<const stm::LandmarkCarrier>(
        face->parts->face_vertices(), face->parts->face_faces(), *face->follower,
        models->face.landmarks68, known, seen);
  }
  stages.end();
  core::give_memory_back();  // a face is kept for long
  return face;
}

void Face::State::follow(const Eigen::MatrixXd& landmarks, bool known, bool usually,
                         const c10::Device& where) {
  const std::string& wanted = options.follow_landmarks;
  if (wanted == "no" || (wanted == "auto" && !usually)) return;
  const Eigen::MatrixXd& vertices = parts->face_vertices();
  stm::FollowOptions how;
  how.guessed = !known;
  if (!known) how.kriging.noise = kUncertain;
  const stm::LandmarkFollower made(vertices, parts->face_faces(), landmarks, models->face.outward68,
                                   how);
  const int64_t followed = made.num_followed();
  if (2 * followed >= core::kNumLandmarks) {
    follower = std::make_shared<const stm::LandmarkFollower>(made.to(where));
  } else {
    report.notices.push_back(core::join("only ", followed,
                                        " of the 68 landmarks are near the surface: the motion is "
                                        "not made to follow them"));
  }
}

void Face::State::decode_by_stm(const Eigen::MatrixXd& landmarks, bool known, Stages& stages) {
  stages.begin("operators");
  stm::Stm stm = models->stm;
  const Eigen::MatrixXd& vertices = parts->face_vertices();
  const auto operators = operators_of(vertices / stm->options().length_scale, parts->face_faces(),
                                      stm->options().k_eig, options.cache_dir, mesh.name,
                                      [&](double share) { stages.at(share); })
                             .to(at::kFloat, device);

  stages.begin("features");
  const auto features = stm->encode(to_tensor(vertices, device), operators);
  follow(landmarks, known, stm->options().follows_landmarks, device);
  decoder = std::make_unique<const stm::FrameDecoder>(
      stm.ptr(), features, operators,
      stm::DecodeOptions{options.precision, options.memory_mb << 20}, follower);
}

at::Tensor Face::State::in_mesh(const at::Tensor& skin, const at::Tensor& landmarks) const {
  return parts->move(skin, landmarks).matmul(to_mesh);
}

at::Tensor Face::State::in_mesh(const at::Tensor& head) const {
  const auto& pose = report.alignment.to_canonical;
  Eigen::Matrix<double, 4, 4, Eigen::RowMajor> to = Eigen::Matrix4d::Identity();
  to.topLeftCorner<3, 3>() = pose.scale * pose.rotation;
  to.topRightCorner<3, 1>() = pose.translation;
  const Eigen::Matrix<double, 4, 4, Eigen::RowMajor> back = to.inverse();
  const auto tensor = [](const auto& matrix) {
    return at::from_blob(const_cast<double*>(matrix.data()), {4, 4}, at::kDouble);
  };
  return tensor(back).matmul(head).matmul(tensor(to)).contiguous();
}

}  // namespace freetalk::talker
