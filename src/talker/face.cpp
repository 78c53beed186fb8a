#include "freetalk/talker/face.h"

#include <ATen/ATen.h>
#include <torch/torch.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "core/scratch.h"
#include "face_state.h"
#include "freetalk/animation/resample.h"
#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "freetalk/core/options.h"
#include "freetalk/core/torch_error.h"
#include "freetalk/stm/adaptive_decoder.h"
#include "freetalk/talker/head_motion.h"
#include "head_decoder.h"
#include "motion.h"
#include "stages.h"

namespace freetalk::talker {
namespace {

nlohmann::ordered_json options_of(const AnimateOptions& chosen, const FaceOptions& prepared) {
  TalkerOptions options;
  static_cast<AnimateOptions&>(options) = chosen;
  static_cast<FaceOptions&>(options) = prepared;
  auto json = nlohmann::ordered_json::parse(core::options_to_json(options));
  for (const char* folder : {"cache_dir", "scratch_dir"}) json.erase(folder);
  return json;
}

std::string metadata(const AnimateOptions& options, const FaceOptions& prepared,
                     const Report& report, const stm::AdaptiveReport& decoded) {
  const auto& found = report.alignment;
  const auto& turn = found.to_canonical.rotation;
  nlohmann::ordered_json root;
  root["format"] = "freetalk-animation";
  root["version"] = 1;
  root["options"] = options_of(options, prepared);
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
  root["decoding"] = {{"decoded_frames", decoded.decoded},
                      {"error", decoded.mean_error},
                      {"error_mm", decoded.max_error_mm}};
  return root.dump();
}

/// Sums of frames, and the largest errors.
void add_decoded(Report& report, const stm::AdaptiveReport& decoded) {
  report.num_frames += decoded.frames;
  report.decoded_frames += decoded.decoded;
  report.decode_error = std::max(report.decode_error, decoded.mean_error);
  report.decode_error_mm = std::max(report.decode_error_mm, decoded.max_error_mm);
}

/// The places of the results: those of the caller, or new ones.
std::vector<at::Tensor> places(const at::Tensor& out, const std::optional<std::string>& scratch_dir,
                               at::IntArrayRef sizes) {
  const auto count = static_cast<size_t>(sizes[0]);
  if (out.defined()) {
    FREETALK_CHECK(out.sizes() == sizes && out.scalar_type() == at::kFloat && out.is_cpu() &&
                       out.is_contiguous(),
                   "out must be ", sizes, ", contiguous, float32 and on the CPU; found ",
                   out.sizes(), " of type ", out.scalar_type(), " on ", out.device());
    return out.unbind();
  }
  std::vector<at::Tensor> result;
  for (size_t k = 0; k < count; ++k) {
    result.push_back(scratch_dir
                         ? core::scratch_tensor(sizes.slice(1), int64_t{64} << 20, *scratch_dir)
                         : at::empty(sizes.slice(1), at::kFloat));
  }
  return result;
}

}  // namespace

Face::Face(std::shared_ptr<const State> state) : state_(std::move(state)) {}

const mesh::Mesh& Face::mesh() const { return state_->mesh; }
const FaceOptions& Face::options() const { return state_->options; }
const geometry::Alignment& Face::alignment() const { return state_->report.alignment; }
const Report& Face::report() const { return state_->report; }

int64_t Face::num_frames(const audio::Audio& audio, double fps) {
  return core::num_frames(audio.duration_s(), fps);
}

animation::Animation Face::animate(const audio::Audio& audio, const AnimateOptions& options,
                                   const Progress& progress, Report* report,
                                   const at::Tensor& out) const {
  return animate_many(audio, {options.seed}, options, progress, report,
                      out.defined() ? out.unsqueeze(0) : out)
      .front();
}

std::vector<animation::Animation> Face::animate_many(const audio::Audio& audio,
                                                     const std::vector<int64_t>& seeds,
                                                     const AnimateOptions& options,
                                                     const Progress& progress, Report* report,
                                                     const at::Tensor& out) const {
  return core::with_plain_errors("animate", [&] {
    const torch::NoGradGuard no_grad;
    const State& face = *state_;
    check_performance(audio, seeds, options, face.options.precision, *face.models);
    const int64_t frames = num_frames(audio, options.fps);
    const auto results =
        places(out, options.scratch_dir,
               {static_cast<int64_t>(seeds.size()), frames, face.mesh.num_vertices(), 3});
    Report own_report;
    Report& found = report != nullptr ? *report : own_report;
    found = face.report;
    found.timings.clear();
    Stages stages(progress, found);
    const auto motions = motion_of(*face.models, audio, frames, seeds, options,
                                   face.options.precision, face.device, stages, found);
    stages.begin("surface");
    std::vector<animation::Animation> animations;
    for (size_t k = 0; k < seeds.size(); ++k) {
      const auto before = static_cast<double>(k);
      stm::AdaptiveReport decoded;
      const Motion& motion = motions[k];
      const auto progress_of = [&](double share) {
        stages.at((before + share) / static_cast<double>(seeds.size()));
      };
      const at::Tensor landmarks = face.carried(motion.landmarks);
      const auto place = [&](int64_t first, const at::Tensor& skin) {
        const auto part = results[k].narrow(0, first, skin.size(0));
        part.copy_(face.in_mesh(skin, landmarks.narrow(0, first, skin.size(0))));
        core::release_pages(part);
        return static_cast<double>(first + skin.size(0)) / static_cast<double>(frames);
      };
      const auto* by_head = dynamic_cast<const HeadDecoder*>(face.decoder.get());
      if (by_head != nullptr && motion.codes.defined()) {
        const at::Tensor codes = by_head->codes_of(motion.codes, face.models->facetalk->options(),
                                                   motion.spoken, motion.landmarks);
        by_head->decode_codes(codes, landmarks, [&](int64_t first, const at::Tensor& skin) {
          progress_of(place(first, skin));
        });
        decoded = {frames, frames, 0.0, 0.0};
      } else {
        stm::decode_adaptively(*face.decoder, landmarks.to(face.device), place,
                               {.tolerance_mm = options.tolerance_mm}, &decoded, progress_of);
      }
      add_decoded(found, decoded);
      AnimateOptions used = options;
      used.seed = seeds[k];
      at::Tensor head;
      if (options.head_motion) {
        head =
            face.in_mesh(head_motion(audio, frames, options.fps, static_cast<uint64_t>(seeds[k])));
      }
      animations.push_back({face.mesh, results[k], options.fps, audio,
                            metadata(used, face.options, found, decoded), face.frame, head,
                            motion.landmarks});
    }
    stages.end();
    return animations;
  });
}

}  // namespace freetalk::talker
