// Model folders: config.json (format, version, options) + model.safetensors.
#pragma once

#include <torch/nn/module.h>

#include <filesystem>
#include <string>

#include "freetalk/core/options.h"
#include "freetalk/core/safetensors.h"

namespace freetalk::core {

/// Parameters and buffers of `module` under their dotted names.
TensorMap state_of(const torch::nn::Module& module);

/// Copies `state` into `module`, converting dtype and device.
/// @throws std::runtime_error naming `where` and every missing, unexpected or misshaped tensor.
void load_state(torch::nn::Module& module, const TensorMap& state, const std::string& where);

/// The text of the "options" object in DIR/config.json. @throws std::runtime_error naming the file
/// when it is missing, broken, or of another `format`.
std::string read_model_options(const std::filesystem::path& directory, const std::string& format);

/// Writes DIR/config.json and DIR/model.safetensors.
void save_model(const std::filesystem::path& directory, const std::string& format,
                const std::string& options_json, const torch::nn::Module& module);

/// Builds a model from its folder: `Holder` is a torch module holder over `Options`.
template <class Holder, class Options>
Holder load_model(const std::filesystem::path& directory, const std::string& format) {
  Options options;
  options_from_json(options, read_model_options(directory, format),
                    (directory / "config.json").string());
  Holder model(options);
  const auto weights = directory / "model.safetensors";
  load_state(*model, load_safetensors(weights), weights.string());
  model->eval();
  return model;
}

}  // namespace freetalk::core
