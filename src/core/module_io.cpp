#include "freetalk/core/module_io.h"

#include <c10/core/GradMode.h>

#include <functional>
#include <nlohmann/json.hpp>
#include <optional>

#include "core/file.h"
#include "freetalk/core/error.h"

namespace freetalk::core {
namespace {

using Json = nlohmann::ordered_json;
constexpr int kVersion = 1;
constexpr const char* kSaveId = "save_id";  // of config.json, the same in the weights' copy of it
constexpr const char* kConfig = "freetalk_config";

/// The configuration that weights were saved with, where `config` beside them is of another save:
/// the saving was stopped between the two files. A config.json edited by hand keeps its id.
std::optional<Json> config_of_weights(const std::filesystem::path& weights, const Json& config) {
  if (!config.contains(kSaveId) || !std::filesystem::exists(weights)) return std::nullopt;
  const Metadata metadata = SafetensorsFile(weights).metadata();
  const auto text = metadata.find(kConfig);
  if (text == metadata.end()) return std::nullopt;
  auto saved = Json::parse(text->second, nullptr, false);
  const bool another =
      saved.is_object() && saved.contains(kSaveId) && saved[kSaveId] != config[kSaveId];
  return another ? std::optional(std::move(saved)) : std::nullopt;
}

}  // namespace

TensorMap state_of(const torch::nn::Module& module) {
  TensorMap state;
  for (const auto& item : module.named_parameters()) state[item.key()] = item.value();
  for (const auto& item : module.named_buffers()) state[item.key()] = item.value();
  return state;
}

void load_state(torch::nn::Module& module, const TensorMap& state, const std::string& where) {
  const TensorMap own = state_of(module);
  std::string problems;
  for (const auto& [name, tensor] : own) {
    const auto found = state.find(name);
    if (found == state.end()) {
      problems += join("\n  missing: ", name);
    } else if (found->second.sizes() != tensor.sizes()) {
      problems += join("\n  shape of ", name, ": expected ", tensor.sizes(), ", found ",
                       found->second.sizes());
    }
  }
  for (const auto& item : state) {
    if (own.count(item.first) == 0) problems += join("\n  unexpected: ", item.first);
  }
  FREETALK_RUNTIME_CHECK(problems.empty(), where,
                         ": the weights do not fit the options:", problems);
  const c10::NoGradGuard no_grad;
  for (const auto& [name, tensor] : own) {
    at::Tensor destination = tensor;
    destination.copy_(state.at(name));
  }
}

std::string read_model_config(const std::filesystem::path& directory) {
  const auto path = directory / "config.json";
  const auto config = Json::parse(read_text(path), nullptr, false);
  FREETALK_RUNTIME_CHECK(config.is_object(), path.string(),
                         ": is not a JSON object; copy the file again");
  return config_of_weights(directory / "model.safetensors", config).value_or(config).dump();
}

std::string read_model_options(const std::filesystem::path& directory, const std::string& format) {
  const auto path = directory / "config.json";
  const auto config = Json::parse(read_model_config(directory));
  const auto text = [&](const char* key) {
    return config.contains(key) && config[key].is_string() ? config[key].get<std::string>()
                                                           : "none";
  };
  FREETALK_RUNTIME_CHECK(text("format") == format, path.string(), ": expected format ", format,
                         ", found ", text("format"));
  const Json version = config.contains("version") ? config["version"] : Json(kVersion);
  FREETALK_RUNTIME_CHECK(version == kVersion, path.string(), ": is of version ", version.dump(),
                         ", this freetalk reads version ", kVersion, "; update freetalk");
  FREETALK_RUNTIME_CHECK(config.contains("options"), path.string(),
                         ": is not a model configuration (no \"options\")");
  return config.at("options").dump();
}

void save_model_files(const std::filesystem::path& directory, const std::string& config,
                      const TensorMap& tensors) {
  auto json = Json::parse(config);
  json["version"] = kVersion;
  json.erase(kSaveId);
  json[kSaveId] = std::to_string(std::hash<std::string>{}(json.dump()));
  save_safetensors(directory / "model.safetensors", tensors,
                   {{"format", "pt"}, {kConfig, json.dump()}});
  write_file_atomic(directory / "config.json", json.dump(2) + "\n");
}

void save_model(const std::filesystem::path& directory, const std::string& format,
                const std::string& options_json, const torch::nn::Module& module) {
  const Json config = {
      {"format", format}, {"version", kVersion}, {"options", Json::parse(options_json)}};
  save_model_files(directory, config.dump(), state_of(module));
}

}  // namespace freetalk::core
