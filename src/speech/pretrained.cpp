#include "freetalk/speech/pretrained.h"

#include <torch/torch.h>

#include <nlohmann/json.hpp>
#include <set>

#include "core/file.h"
#include "freetalk/core/error.h"
#include "freetalk/core/module_io.h"
#include "freetalk/core/options.h"
#include "freetalk/core/safetensors.h"

namespace freetalk::speech {
namespace {

using Json = nlohmann::ordered_json;

Json parse_object(const std::string& text, const std::string& where) {
  auto json = Json::parse(text, nullptr, /*allow_exceptions=*/false);
  FREETALK_RUNTIME_CHECK(json.is_object(), where, ": is not a JSON object; copy the file again");
  return json;
}

/// Tensors of model.safetensors, or of the shards that an index lists.
core::TensorMap read_weights(const std::filesystem::path& dir) {
  const auto index_path = dir / "model.safetensors.index.json";
  const auto single = dir / "model.safetensors";
  if (std::filesystem::exists(single) || !std::filesystem::exists(index_path)) {
    FREETALK_RUNTIME_CHECK(std::filesystem::exists(single), single.string(),
                           ": there is no such file; a speech encoder is a folder with config.json "
                           "and model.safetensors (a pytorch_model.bin has to be converted first)");
    return core::load_safetensors(single);
  }
  const auto index = parse_object(core::read_text(index_path), index_path.string());
  FREETALK_RUNTIME_CHECK(index.contains("weight_map") && index["weight_map"].is_object(),
                         index_path.string(), ": has no \"weight_map\"; copy the file again");
  std::set<std::string> shards;
  for (const auto& shard : index["weight_map"]) {
    FREETALK_RUNTIME_CHECK(shard.is_string(), index_path.string(),
                           ": \"weight_map\" holds something other than file names");
    shards.insert(std::filesystem::path(shard.get<std::string>()).filename().string());
  }
  core::TensorMap tensors;
  for (const auto& shard : shards) {
    tensors.merge(core::load_safetensors(dir / shard));
  }
  return tensors;
}

bool replace_end(std::string& name, const std::string& end, const std::string& replacement) {
  if (name.size() < end.size() || name.compare(name.size() - end.size(), end.size(), end) != 0) {
    return false;
  }
  name.replace(name.size() - end.size(), end.size(), replacement);
  return true;
}

/// The encoder's tensors under their current names, without the heads of task checkpoints.
core::TensorMap encoder_state(const core::TensorMap& tensors) {
  std::string prefix;
  for (const auto& item : tensors) {
    for (const std::string candidate : {"hubert.", "wav2vec2."}) {
      if (item.first.rfind(candidate, 0) == 0) {
        prefix = candidate;
      }
    }
  }
  core::TensorMap state;
  for (const auto& [key, tensor] : tensors) {
    if (key.rfind(prefix, 0) != 0) {
      continue;  // a head beside the encoder
    }
    std::string name = key.substr(prefix.size());
    if (name == "masked_spec_embed") {
      continue;  // only pre-training uses it
    }
    const std::string conv = "pos_conv_embed.conv.";
    replace_end(name, conv + "weight_g", conv + "parametrizations.weight.original0") ||
        replace_end(name, conv + "weight_v", conv + "parametrizations.weight.original1");
    state[name] = tensor;
  }
  return state;
}

bool is_true(const Json& config, const char* key) {
  const auto found = config.find(key);
  return found != config.end() && found->is_boolean() && found->get<bool>();
}

}  // namespace

SpeechEncoderOptions options_from_config(const std::string& json, const std::string& where) {
  const Json config = parse_object(json, where);
  const auto model_type = config.find("model_type");
  FREETALK_RUNTIME_CHECK(model_type != config.end() && model_type->is_string(), where,
                         ": has no \"model_type\"; expected hubert or wav2vec2");
  FREETALK_RUNTIME_CHECK(*model_type == "hubert" || *model_type == "wav2vec2", where,
                         ": unknown architecture '", model_type->get<std::string>(),
                         "'; expected hubert or wav2vec2");
  for (const char* key : {"add_adapter", "conv_pos_batch_norm"}) {
    FREETALK_RUNTIME_CHECK(!is_true(config, key), where, ": ", key,
                           " is not supported; use a checkpoint without it");
  }
  FREETALK_RUNTIME_CHECK(
      !config.contains("adapter_attn_dim") || config["adapter_attn_dim"].is_null(), where,
      ": adapter_attn_dim is not supported; use a checkpoint without it");
  SpeechEncoderOptions options;
  Json known = Json::object();
  for (const auto& option : core::list_options(options)) {
    const auto found = config.find(option.name);
    if (found != config.end() && !found->is_null()) {
      known[option.name] = *found;
    }
  }
  for (const char* key : {"hidden_act", "feat_extract_activation"}) {
    if (known.contains(key) && known[key] == "swish") {
      known[key] = "silu";
    }
  }
  if (*model_type == "wav2vec2") {
    known["feat_proj_layer_norm"] = true;  // `transformers` reads this key for HuBERT only
  }
  try {
    core::options_from_json(options, known.dump(), where);
  } catch (const std::invalid_argument& error) {
    throw std::runtime_error(core::join(where, ": ", error.what()));
  }
  return options;
}

SpeechEncoder load_speech_encoder(const std::filesystem::path& dir) {
  FREETALK_RUNTIME_CHECK(std::filesystem::is_directory(dir), dir.string(),
                         ": is not a folder; a speech encoder is a folder with config.json and "
                         "model.safetensors");
  const auto config_path = dir / "config.json";
  SpeechEncoder encoder(options_from_config(core::read_model_config(dir), config_path.string()));
  core::with_plain_errors("load_speech_encoder", [&] {
    core::load_state(*encoder, encoder_state(read_weights(dir)),
                     (dir / "model.safetensors").string());
  });
  encoder->eval();
  return encoder;
}

void save_speech_encoder(const SpeechEncoder& encoder, const std::filesystem::path& dir, bool half,
                         const std::string& extra_json) {
  const auto& options = encoder->options();
  const auto extra = Json::parse(extra_json, nullptr, /*allow_exceptions=*/false);
  FREETALK_CHECK(extra.is_object(), "extra_json is not a JSON object");
  Json config = {{"architectures",
                  Json::array({options.model_type == "hubert" ? "HubertModel" : "Wav2Vec2Model"})}};
  config.update(Json::parse(core::options_to_json(options)));
  config["num_feat_extract_layers"] = options.conv_dim.size();
  config["mask_time_prob"] = 0.0;
  config["torch_dtype"] = half ? "float16" : "float32";
  for (const auto& [key, value] : extra.items()) {
    FREETALK_CHECK(!config.contains(key), "extra_json: '", key, "' is an option of the encoder");
    config[key] = value;
  }
  core::TensorMap state;
  for (const auto& [name, tensor] : core::state_of(*encoder)) {
    state[name] = tensor.detach().to(half ? at::kHalf : at::kFloat);
  }
  core::save_model_files(dir, config.dump(), state);
}

}  // namespace freetalk::speech
