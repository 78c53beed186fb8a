#include "freetalk/talker/talker.h"

#include <ATen/ATen.h>
#include <torch/torch.h>

#include <Eigen/Geometry>

#include <nlohmann/json.hpp>

#include <algorithm>
#include <chrono>
#include <map>

#include "freetalk/animation/parts.h"
#include "freetalk/animation/resample.h"
#include "freetalk/core/error.h"
#include "freetalk/core/options.h"
#include "freetalk/core/random.h"
#include "freetalk/geometry/operators.h"
#include "freetalk/speech/features.h"
#include "rest.h"

namespace freetalk::talker {
namespace {

/// Times stages and passes progress on.
class Stages {
 public:
  Stages(const Progress& progress, Report& report) : progress_(progress), report_(report) {}

  void begin(const std::string& stage) {
    end();
    stage_ = stage;
    start_ = std::chrono::steady_clock::now();
    at(0);
  }
  void at(double fraction) const {
    if (progress_) progress_(stage_, fraction);
  }
  void end() {
    if (stage_.empty()) return;
    at(1);
    const std::chrono::duration<double> passed = std::chrono::steady_clock::now() - start_;
    report_.timings.push_back({stage_, passed.count()});
    stage_.clear();
  }

 private:
  const Progress& progress_;
  Report& report_;
  std::string stage_;
  std::chrono::steady_clock::time_point start_;
};

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
  static const std::map<std::string, double> metres = {
      {"m", 1.0}, {"cm", 0.01}, {"mm", 0.001}, {"in", 0.0254}};
  const auto unit = metres.find(alignment.unit);
  frame.metres_per_unit = unit == metres.end() ? alignment.to_canonical.scale : unit->second;
  return frame;
}

/// Operators with exactly `k` eigenpairs: a mesh of fewer vertices is completed with empty ones.
geometry::SurfaceOperators operators_of(const Eigen::MatrixXd& vertices,
                                        const Eigen::MatrixXi& faces, int64_t k,
                                        const std::string& cache_dir, const std::string& name) {
  geometry::OperatorOptions options;
  options.k_eig = std::min<int64_t>(k, vertices.rows());
  auto operators = geometry::cached_surface_operators(vertices, faces, options, cache_dir, name);
  const int64_t missing = k - options.k_eig;
  if (missing > 0) {
    operators.evals = at::cat({operators.evals, operators.evals.slice(0, -1).expand({missing})});
    operators.evecs = at::constant_pad_nd(operators.evecs, {0, missing});
  }
  return operators;
}

at::Tensor to_tensor(const Eigen::MatrixXd& matrix, const c10::Device& device) {
  const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> rows = matrix;
  return at::from_blob(const_cast<double*>(rows.data()), {rows.rows(), rows.cols()}, at::kDouble)
      .to(device, at::kFloat, /*non_blocking=*/false, /*copy=*/true);
}

ats::GenerateOptions sampling(const TalkerOptions& options, ats::GenerateOptions own) {
  if (options.num_steps > 0) own.num_steps = options.num_steps;
  if (options.eta >= 0) own.eta = options.eta;
  if (options.audio_guidance >= 0) own.audio_guidance = options.audio_guidance;
  if (options.affect_guidance >= 0) own.affect_guidance = options.affect_guidance;
  return own;
}

std::string metadata(const TalkerOptions& options, const Report& report) {
  const auto& found = report.alignment;
  const auto& turn = found.to_canonical.rotation;
  nlohmann::ordered_json root;
  root["format"] = "freetalk-animation";
  root["version"] = 1;
  root["options"] = nlohmann::ordered_json::parse(core::options_to_json(options));
  root["options"].erase("cache_dir");
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  for (int i = 0; i < 3; ++i) rows.push_back({turn(i, 0), turn(i, 1), turn(i, 2)});
  const auto& shift = found.to_canonical.translation;
  root["alignment"] = {{"summary", found.summary},
                       {"unit", found.unit},
                       {"up", found.up},
                       {"forward", found.forward},
                       {"residual_m", found.residual_m},
                       {"to_canonical",
                        {{"scale", found.to_canonical.scale},
                         {"rotation", rows},
                         {"translation", {shift.x(), shift.y(), shift.z()}}}}};
  root["parts"] = report.parts;
  root["notices"] = report.notices;
  return root.dump();
}

/// (T, 68, 3) float32 m at the requested rate, on the CPU.
at::Tensor landmark_motion(TalkerModels& models, const audio::Audio& audio, int64_t frames,
                           const TalkerOptions& options, c10::Device device, Stages& stages,
                           Report& report) {
  const auto& own = models.ats->options();
  const auto emotion = ats::parse_emotion(options.emotion, own.emotions);
  const auto seed = static_cast<uint64_t>(options.seed);
  if (is_silent(audio)) {
    report.notices.push_back("the audio is silent: the face rests, breathes and blinks");
    return rest_motion(models.face.landmarks68, frames, options.fps, seed);
  }
  stages.begin("speech");
  const auto heard = audio.sample_rate_hz == speech::kSampleRateHz
                         ? audio
                         : audio::resample(audio, speech::kSampleRateHz);
  const auto samples = at::tensor(heard.samples);
  const auto features = speech::encode_speech(models.speech, samples, own.fps, {},
                                              [&](double share) { stages.at(share); });
  stages.begin("motion");
  const bool neutral = own.emotions.front() == "neutral" && emotion[0].item<float>() == 1.0f;
  const double strongest = static_cast<double>(own.num_intensities);
  const double intensity = neutral ? 1.0 : std::min(options.intensity, strongest);
  const auto motion =
      ats::generate(models.ats, features.to(device), emotion.to(device), intensity,
                    sampling(options, models.generate), core::make_generator(seed, device),
                    [&](int64_t done, int64_t total) {
                      stages.at(static_cast<double>(done) / static_cast<double>(total));
                    });
  return animation::resample_motion(motion.to(at::kCPU), own.fps, options.fps, frames);
}

}  // namespace

Talker::Talker(TalkerModels models, c10::Device device)
    : models_(std::move(models)), device_(device) {
  FREETALK_CHECK(models_.speech && models_.ats && models_.stm,
                 "Talker needs a speech encoder, an ATS and an STM");
  models_.speech->to(device);
  models_.ats->to(device);
  models_.stm->to(device);
  models_.speech->eval();
  models_.ats->eval();
  models_.stm->eval();
}

geometry::Alignment Talker::align(const geometry::Mesh& mesh,
                                  const geometry::AlignOptions& options) const {
  return geometry::align_to_template(mesh.vertices, mesh.faces, models_.face.points,
                                     models_.face.normals, options);
}

animation::Animation Talker::animate(const audio::Audio& audio, const geometry::Mesh& mesh,
                                     const TalkerOptions& options, const Progress& progress,
                                     Report* report) {
  const torch::NoGradGuard no_grad;
  options.check();
  ats::parse_emotion(options.emotion, emotions());
  audio.check();
  FREETALK_CHECK(!audio.samples.empty(), "the audio has no samples");
  Report own_report;
  Report& found = report != nullptr ? *report : own_report;
  found = Report{};
  Stages stages(progress, found);

  stages.begin("align");
  found.alignment = align(mesh, {options.unit, options.up, options.forward});
  if (!found.alignment.face_like) {
    found.notices.push_back(
        core::join(found.alignment.summary, ": give unit, up and forward if the guess is wrong"));
  }
  const auto& pose = found.alignment.to_canonical;
  const animation::Parts parts(pose.apply(mesh.vertices), mesh.faces, models_.face.landmarks68);
  found.parts = parts.summary();

  stages.begin("operators");
  const auto& stm_options = models_.stm->options();
  const auto operators =
      operators_of(parts.face_vertices() / stm_options.length_scale, parts.face_faces(),
                   stm_options.k_eig, options.cache_dir, mesh.name)
          .to(at::kFloat, device_);

  const int64_t frames = animation::num_frames(audio.duration_s(), options.fps);
  const auto landmarks = landmark_motion(models_, audio, frames, options, device_, stages, found);

  stages.begin("surface");
  animation::Animation result;
  result.displacements = at::empty({frames, mesh.num_vertices(), 3}, at::kFloat);
  const auto back = to_tensor(pose.rotation / pose.scale, c10::kCPU);  // rows: d R / s
  const auto features = models_.stm->encode(to_tensor(parts.face_vertices(), device_), operators);
  stm::decode_chunked(
      models_.stm, features, operators, landmarks.to(device_),
      [&](int64_t first, const at::Tensor& skin) {
        const int64_t count = skin.size(0);
        const auto moved = parts.move(skin, landmarks.narrow(0, first, count));
        result.displacements.narrow(0, first, count).copy_(moved.matmul(back));
        stages.at(static_cast<double>(first + count) / static_cast<double>(frames));
      },
      options.memory_mb << 20);
  stages.end();

  result.mesh = mesh;
  result.fps = options.fps;
  result.audio = audio;
  result.frame = frame_of(found.alignment);
  result.metadata_json = metadata(options, found);
  return result;
}

}  // namespace freetalk::talker
