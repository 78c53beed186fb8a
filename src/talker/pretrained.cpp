#include <ATen/ATen.h>
#include <torch/cuda.h>

#include <nlohmann/json.hpp>

#include "core/file.h"
#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "freetalk/core/module_io.h"
#include "freetalk/core/safetensors.h"
#include "freetalk/speech/pretrained.h"
#include "freetalk/talker/models.h"
#include "freetalk/talker/talker.h"

namespace freetalk::talker {
namespace {

Eigen::MatrixXd to_matrix(const at::Tensor& tensor) {
  const auto rows = tensor.to(at::kDouble).contiguous();
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
  return Eigen::Map<const Rows>(rows.data_ptr<double>(), rows.size(0), 3);
}

Template load_template(const std::filesystem::path& path) {
  const core::SafetensorsFile file(path);
  const auto read = [&](const std::string& key) {
    const auto tensor = file.tensor(key);
    FREETALK_RUNTIME_CHECK(tensor.dim() == 2 && tensor.size(1) == 3, path.string(), ": '", key,
                           "' must be (N, 3), found ", tensor.sizes());
    return to_matrix(tensor);
  };
  Template face{read("points"), read("normals"), read("landmarks68"),
                Eigen::MatrixXd::Zero(core::kNumLandmarks, 3)};
  if (file.contains("outward68")) face.outward68 = read("outward68");
  FREETALK_RUNTIME_CHECK(face.points.rows() == face.normals.rows(), path.string(),
                         ": 'points' and 'normals' differ in number");
  FREETALK_RUNTIME_CHECK(face.landmarks68.rows() == core::kNumLandmarks &&
                             face.outward68.rows() == core::kNumLandmarks,
                         path.string(), ": expected ", core::kNumLandmarks, " landmarks");
  return face;
}

/// Checks talker.json and reads its optional objects "generate" and "facetalk".
void load_description(const std::filesystem::path& path, TalkerModels& models) {
  const auto root = nlohmann::json::parse(core::read_text(path), nullptr, false);
  FREETALK_RUNTIME_CHECK(root.is_object(), path.string(), ": is not a JSON object");
  const std::string format = root.value("format", "");
  FREETALK_RUNTIME_CHECK(format == "freetalk-talker", path.string(),
                         ": expected format freetalk-talker, found '", format, "'");
  FREETALK_RUNTIME_CHECK(root.value("version", 0) == 1, path.string(), ": version ",
                         root.value("version", 0), " is newer than this freetalk; update it");
  if (root.contains("generate")) {
    core::options_from_json(models.generate, root["generate"].dump(), path.string());
  }
  if (root.contains("facetalk")) {
    core::options_from_json(models.code_motion, root["facetalk"].dump(), path.string());
  }
}

}  // namespace

Talker Talker::from_pretrained(const std::filesystem::path& directory,
                               std::optional<c10::Device> device) {
  const auto description = directory / "talker.json";
  FREETALK_RUNTIME_CHECK(std::filesystem::is_regular_file(description), directory.string(),
                         ": holds no talker.json; give a folder of freetalk weights");
  TalkerModels models;
  load_description(description, models);
  models.speech = speech::load_speech_encoder(directory / "speech");
  models.ats = core::load_model<ats::Ats, ats::AtsOptions>(directory / "ats", "freetalk-ats");
  models.stm = core::load_model<stm::Stm, stm::StmOptions>(directory / "stm", "freetalk-stm");
  models.face = load_template(directory / "template.safetensors");
  const auto poses = directory / "rig_poses.safetensors";
  if (std::filesystem::exists(poses)) models.rig = rig::RigPoses::load(poses);
  const int64_t heard = models.speech->options().hidden_size;
  const int64_t wanted = models.ats->options().audio_dim;
  FREETALK_RUNTIME_CHECK(heard == wanted, directory.string(), ": speech/ gives ", heard,
                         " channels but ats/ expects ", wanted);
  if (const auto folder = directory / "facetalk"; std::filesystem::exists(folder / "config.json")) {
    models.facetalk = core::load_model<facetalk::FaceTalk, facetalk::FaceTalkOptions>(
        folder, "freetalk-facetalk");
    const auto& own = models.facetalk->options();
    FREETALK_RUNTIME_CHECK(own.condition == "audio" && own.audio_dim == heard, folder.string(),
                           ": hears ", own.condition, " of ", own.audio_dim,
                           " channels, but speech/ gives ", heard);
  }
  if (const auto folder = directory / "head"; std::filesystem::exists(folder / "config.json")) {
    models.head =
        core::load_model<head::ParametricHead, head::HeadOptions>(folder, "freetalk-head");
    const int64_t codes = models.head->options().expression_dim;
    const bool speaks = models.facetalk && models.facetalk->options().codes == "head";
    FREETALK_RUNTIME_CHECK(!speaks || models.facetalk->options().code_dim == codes,
                           directory.string(), ": facetalk/ speaks codes of ",
                           models.facetalk->options().code_dim,
                           " channels, but those of head/ have ", codes);
  }
  const bool gpu = torch::cuda::is_available();
  return Talker(std::move(models), device.value_or(gpu ? c10::Device(c10::kCUDA) : c10::kCPU));
}

}  // namespace freetalk::talker
