#include "freetalk/core/module_io.h"

#include <c10/core/GradMode.h>

#include <nlohmann/json.hpp>

#include "freetalk/core/error.h"
#include "freetalk/core/file.h"

namespace freetalk::core {

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

std::string read_model_options(const std::filesystem::path& directory, const std::string& format) {
  const auto path = directory / "config.json";
  const auto config = nlohmann::ordered_json::parse(read_text(path), nullptr, false);
  FREETALK_RUNTIME_CHECK(config.is_object() && config.contains("options"), path.string(),
                         ": is not a model configuration (no \"options\")");
  const auto found = config.value("format", std::string("none"));
  FREETALK_RUNTIME_CHECK(found == format, path.string(), ": expected format ", format, ", found ",
                         found);
  return config.at("options").dump();
}

void save_model(const std::filesystem::path& directory, const std::string& format,
                const std::string& options_json, const torch::nn::Module& module) {
  const nlohmann::ordered_json config = {
      {"format", format}, {"version", 1}, {"options", nlohmann::ordered_json::parse(options_json)}};
  save_safetensors(directory / "model.safetensors", state_of(module));
  write_file_atomic(directory / "config.json", config.dump(2) + "\n");
}

}  // namespace freetalk::core
