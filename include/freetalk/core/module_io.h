// Model folders: config.json (format, version, options) + model.safetensors.
#pragma once

#include <torch/nn/module.h>

#include <filesystem>
#include <string>

#include "freetalk/core/options.h"
#include "freetalk/core/safetensors.h"
#include "freetalk/core/torch_error.h"

namespace freetalk::core {

/// Parameters and buffers of `module` under their dotted names.
TensorMap state_of(const torch::nn::Module& module);

/// Copies `state` into `module`, converting dtype and device.
/// @throws std::runtime_error naming `where` and every missing, unexpected or misshaped tensor.
void load_state(torch::nn::Module& module, const TensorMap& state, const std::string& where);

/// The text of DIR/config.json, a JSON object; that of the copy in DIR/model.safetensors where a
/// stop between the two files left the weights of a newer model. @throws std::runtime_error naming
/// the file when it is missing or broken.
std::string read_model_config(const std::filesystem::path& directory);

/// The text of the "options" object in DIR/config.json. @throws std::runtime_error naming the file
/// when it is missing, broken, of another `format` or of a newer version.
std::string read_model_options(const std::filesystem::path& directory, const std::string& format);

/// Writes DIR/model.safetensors and DIR/config.json with `config` (a JSON object: format, options
/// and what else is to be kept). The weights carry a copy of their configuration, so that a stop
/// between the two files leaves a folder that reads as the new model.
/// @throws std::runtime_error naming the file that can't be written.
void save_model_files(const std::filesystem::path& directory, const std::string& config,
                      const TensorMap& tensors);

/// Writes a model's folder.
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
  with_plain_errors("load_model",
                    [&] { load_state(*model, load_safetensors(weights), weights.string()); });
  model->eval();
  return model;
}

}  // namespace freetalk::core
