#include "freetalk/talker/talker.h"

#include <ATen/ATen.h>
#include <torch/torch.h>

#include <Eigen/Geometry>

#include <nlohmann/json.hpp>

#include <algorithm>
#include <chrono>
#include <map>

#include "core/scratch.h"
#include "freetalk/animation/parts.h"
#include "freetalk/animation/resample.h"
#include "freetalk/core/error.h"
#include "freetalk/core/options.h"
#include "freetalk/core/random.h"
#include "freetalk/geometry/operators.h"
#include "freetalk/speech/features.h"
#include "freetalk/talker/blinks.h"
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

constexpr int64_t kDpmSolverSteps = 20;  // within 2 % of a hundred steps of DDIM

ats::GenerateOptions sampling(const TalkerOptions& options, ats::GenerateOptions own) {
  if (!options.sampler.empty() && options.sampler != own.sampler) {
    own.sampler = options.sampler;
    own.spacing = "auto";
    own.eta = 0;
    if (own.sampler == "dpmpp") own.num_steps = kDpmSolverSteps;
  }
  if (options.num_steps > 0) own.num_steps = options.num_steps;
  if (options.eta >= 0) own.eta = options.eta;
  if (options.audio_guidance >= 0) own.audio_guidance = options.audio_guidance;
  if (options.affect_guidance >= 0) own.affect_guidance = options.affect_guidance;
  if (options.mouth_temperature >= 0) own.mouth_temperature = options.mouth_temperature;
  own.precision = options.precision;
  return own;
}

/// The emotion over time; neutral has one intensity.
std::vector<ats::EmotionKey> emotion_keys(const TalkerOptions& options,
                                          const ats::AtsOptions& own) {
  auto keys = ats::parse_emotion_keys(options.emotion, own.emotions, options.intensity);
  for (ats::EmotionKey& key : keys) {
    FREETALK_CHECK(key.intensity >= 1 && key.intensity <= 3, "emotion '", options.emotion,
                   "': intensity must be between 1 and 3, found ", key.intensity);
    const bool neutral = own.emotions.front() == "neutral" && key.emotion[0].item<float>() == 1.0f;
    const auto strongest = static_cast<double>(own.num_intensities);
    key.intensity = neutral ? 1.0 : std::min(key.intensity, strongest);
  }
  return keys;
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

/// Motion that each seed gives to the speech, (T, 68, 3) float32 m at the requested rate, on the
/// CPU.
std::vector<at::Tensor> spoken_motion(TalkerModels& models, const audio::Audio& audio,
                                      int64_t frames, const std::vector<int64_t>& seeds,
                                      const TalkerOptions& options, c10::Device device,
                                      Stages& stages) {
  const auto& own = models.ats->options();
  stages.begin("speech");
  const auto heard = audio.sample_rate_hz == speech::kSampleRateHz
                         ? audio
                         : audio::resample(audio, speech::kSampleRateHz);
  const auto samples = at::tensor(heard.samples);
  const auto features = speech::encode_speech(models.speech, samples, own.fps, {},
                                              [&](double share) { stages.at(share); });
  stages.begin("motion");
  const auto keys = emotion_keys(options, own);
  const auto felt = keys.size() == 1
                        ? ats::constant_affect(keys[0].emotion.to(device), keys[0].intensity)
                        : ats::interpolate(keys, features.size(0), own.fps);
  std::vector<at::Generator> generators;
  for (const int64_t seed : seeds) {
    generators.push_back(core::make_generator(static_cast<uint64_t>(seed), device));
  }
  const auto motion =
      ats::generate(models.ats, features.to(device), felt, sampling(options, models.generate),
                    generators, [&](int64_t done, int64_t total) {
                      stages.at(static_cast<double>(done) / static_cast<double>(total));
                    });
  std::vector<at::Tensor> result;
  for (const auto& one : motion.to(at::kCPU).unbind()) {
    result.push_back(animation::resample_motion(one, own.fps, options.fps, frames).contiguous());
  }
  return result;
}

/// Motion of each seed, (T, 68, 3) float32 m at the requested rate, on the CPU.
std::vector<at::Tensor> landmark_motion(TalkerModels& models, const audio::Audio& audio,
                                        int64_t frames, const std::vector<int64_t>& seeds,
                                        const TalkerOptions& options, c10::Device device,
                                        Stages& stages, Report& report) {
  const auto& landmarks = models.face.landmarks68;
  std::vector<at::Tensor> motions;
  if (is_silent(audio)) {
    report.notices.push_back(options.blinks
                                 ? "the audio is silent: the face rests, breathes and blinks"
                                 : "the audio is silent: the face rests and breathes");
    for (size_t k = 0; k < seeds.size(); ++k) {
      motions.push_back(rest_motion(landmarks, frames, options.fps));
    }
  } else {
    motions = spoken_motion(models, audio, frames, seeds, options, device, stages);
  }
  if (options.blinks) {
    for (size_t k = 0; k < seeds.size(); ++k) {
      add_blinks(motions[k], landmarks, options.fps, static_cast<uint64_t>(seeds[k]));
    }
  }
  return motions;
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

geometry::Alignment Talker::align(const mesh::Mesh& mesh,
                                  const geometry::AlignOptions& options) const {
  return geometry::align_to_template(mesh.vertices, mesh.faces, models_.face.points,
                                     models_.face.normals, options);
}

animation::Animation Talker::animate(const audio::Audio& audio, const mesh::Mesh& mesh,
                                     const TalkerOptions& options, const Progress& progress,
                                     Report* report) {
  return animate_many(audio, mesh, {options.seed}, options, progress, report).front();
}

std::vector<animation::Animation> Talker::animate_many(const audio::Audio& audio,
                                                       const mesh::Mesh& mesh,
                                                       const std::vector<int64_t>& seeds,
                                                       const TalkerOptions& options,
                                                       const Progress& progress, Report* report) {
  const torch::NoGradGuard no_grad;
  options.check();
  FREETALK_CHECK(!seeds.empty(), "expected at least one seed");
  for (const int64_t seed : seeds) {
    FREETALK_CHECK(seed >= 0, "seed must not be negative, found ", seed);
  }
  emotion_keys(options, models_.ats->options());
  sampling(options, models_.generate).check();
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
  const auto motions =
      landmark_motion(models_, audio, frames, seeds, options, device_, stages, found);

  stages.begin("surface");
  const auto back = to_tensor(pose.rotation / pose.scale, c10::kCPU);  // rows: d R / s
  const auto features = models_.stm->encode(to_tensor(parts.face_vertices(), device_), operators);
  std::vector<animation::Animation> results;
  for (const auto& landmarks : motions) {
    animation::Animation result;
    result.displacements = core::scratch_tensor({frames, mesh.num_vertices(), 3});
    const auto done_before = static_cast<int64_t>(results.size()) * frames;
    stm::decode_chunked(
        models_.stm, features, operators, landmarks.to(device_),
        [&](int64_t first, const at::Tensor& skin) {
          const int64_t count = skin.size(0);
          const auto moved = parts.move(skin, landmarks.narrow(0, first, count));
          const auto place = result.displacements.narrow(0, first, count);
          place.copy_(moved.matmul(back));
          core::release_pages(place);
          stages.at(static_cast<double>(done_before + first + count) /
                    static_cast<double>(frames * static_cast<int64_t>(motions.size())));
        },
        {options.precision, options.memory_mb << 20});
    result.mesh = mesh;
    result.fps = options.fps;
    result.audio = audio;
    result.frame = frame_of(found.alignment);
    TalkerOptions used = options;
    used.seed = seeds[results.size()];
    result.metadata_json = metadata(used, found);
    results.push_back(std::move(result));
  }
  stages.end();
  return results;
}

}  // namespace freetalk::talker
