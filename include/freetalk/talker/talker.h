// Speech and a face mesh of any topology in, a talking face out: the whole pipeline behind one
// object.
//
//   mesh -> canonical frame -> parts -> surface operators ------------------.
//   speech -> features at the model's rate -> ATS -> landmark motion -> fps -> STM, frame by frame
//   -> parts -> mesh unit
#pragma once

#include <c10/core/Device.h>

#include <Eigen/Core>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "freetalk/animation/animation.h"
#include "freetalk/ats/ats.h"
#include "freetalk/ats/generate.h"
#include "freetalk/audio/audio.h"
#include "freetalk/geometry/alignment.h"
#include "freetalk/mesh/mesh.h"
#include "freetalk/speech/encoder.h"
#include "freetalk/stm/stm.h"

namespace freetalk::talker {

struct TalkerOptions {
  /// A name, an alias ("fear"), a mixture "happy:0.7,sad:0.3", or keys over time
  /// "0=neutral; 2.5=happy:0.7,surprise:0.3@2.5" (seconds=emotion@intensity; linear in between).
  std::string emotion = "neutral";
  double intensity = 2.0;        // 1 (slight) ... 3 (strong); neutral has one intensity
  double fps = 30.0;             // frames per second of the animation, 0 < fps <= 240
  int64_t seed = 0;              // other seeds give other motion for the same speech
  std::string sampler;           // "ddim", "ddpm", "dpmpp"; empty: as the weights say
  int64_t num_steps = 0;         // denoising steps; 0: as the weights say, or 20 with "dpmpp"
  double eta = -1.0;             // DDIM noise in [0, 1]; negative: as the weights say
  double audio_guidance = -1.0;  // see ats::GenerateOptions; negative: as the weights say
  double affect_guidance = -1.0;
  double mouth_temperature = -1.0;    // see ats::GenerateOptions; negative: as the weights say
  bool blinks = true;                 // also blink where the model leaves the eyes open for long
  std::string precision = "float32";  // of ATS and STM: "float32" or "bfloat16" (faster, coarser)
  std::string unit = "auto";          // of the mesh, see geometry::AlignOptions
  std::string up = "auto";
  std::string forward = "auto";
  std::string cache_dir;    // of surface operators; empty: geometry::default_cache_dir()
  int64_t memory_mb = 256;  // working memory of decoding, beside the result

  template <class V>
  void fields(V& v) {
    v("emotion", emotion);
    v("intensity", intensity);
    v("fps", fps);
    v("seed", seed);
    v("sampler", sampler);
    v("num_steps", num_steps);
    v("eta", eta);
    v("audio_guidance", audio_guidance);
    v("affect_guidance", affect_guidance);
    v("mouth_temperature", mouth_temperature);
    v("blinks", blinks);
    v("precision", precision);
    v("unit", unit);
    v("up", up);
    v("forward", forward);
    v("cache_dir", cache_dir);
    v("memory_mb", memory_mb);
  }
  /// @throws std::invalid_argument naming the option at fault (emotions are checked against the
  /// weights').
  void check() const;
};

struct StageTime {
  std::string stage;  // "align", "operators", "speech", "motion", "surface"
  double seconds = 0.0;
};

/// What was found, guessed and measured on the way.
struct Report {
  geometry::Alignment alignment;
  std::string parts;                 // "9409 skin, 2204 with the jaw (vertices)"
  std::vector<std::string> notices;  // sentences that a user should read
  std::vector<StageTime> timings;
};

/// Called with the stage and its finished share in [0, 1]; may throw to stop.
using Progress = std::function<void(const std::string& stage, double fraction)>;

/// Samples of the mean face in the canonical frame, used for alignment and to tell parts apart.
struct Template {
  Eigen::MatrixXd points;       // (P, 3) m
  Eigen::MatrixXd normals;      // (P, 3)
  Eigen::MatrixXd landmarks68;  // (68, 3) m
};

struct TalkerModels {
  speech::SpeechEncoder speech{nullptr};
  ats::Ats ats{nullptr};
  stm::Stm stm{nullptr};
  Template face;
  ats::GenerateOptions generate;  // the weights' own sampling options
};

class Talker {
 public:
  /// Reads talker.json, speech/, ats/, stm/ and template.safetensors.
  /// @param device nothing: the GPU if there is one.
  /// @throws std::runtime_error naming the file that is missing, broken or doesn't fit.
  static Talker from_pretrained(const std::filesystem::path& directory,
                                std::optional<c10::Device> device = std::nullopt);
  explicit Talker(TalkerModels models, c10::Device device = c10::kCPU);

  /// T = max(1, round(duration * fps)) frames. The same options, inputs and machine give the same
  /// bits. Memory beside the (T, V, 3) result doesn't grow with T. Silence gives a resting face and
  /// a notice.
  /// @param report filled if given.
  /// @throws std::invalid_argument for options out of range, an unknown emotion, no samples.
  animation::Animation animate(const audio::Audio& audio, const mesh::Mesh& mesh,
                               const TalkerOptions& options = {}, const Progress& progress = {},
                               Report* report = nullptr);

  /// Several performances of one speech: the motion of all seeds is sampled together, and the mesh
  /// is prepared once. @param seeds take the place of options.seed. @returns one animation a seed,
  /// equal to that of animate() up to rounding.
  std::vector<animation::Animation> animate_many(const audio::Audio& audio, const mesh::Mesh& mesh,
                                                 const std::vector<int64_t>& seeds,
                                                 const TalkerOptions& options = {},
                                                 const Progress& progress = {},
                                                 Report* report = nullptr);

  /// How the mesh lies relative to the canonical frame.
  geometry::Alignment align(const mesh::Mesh& mesh,
                            const geometry::AlignOptions& options = {}) const;

  const std::vector<std::string>& emotions() const { return models_.ats->options().emotions; }
  c10::Device device() const { return device_; }
  const TalkerModels& models() const { return models_; }

 private:
  TalkerModels models_;
  c10::Device device_;
};

}  // namespace freetalk::talker

namespace freetalk {
using talker::Talker;
using talker::TalkerOptions;
}  // namespace freetalk
