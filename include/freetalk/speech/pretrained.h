// Encoders on disk: a folder with `config.json` and `model.safetensors`, as Hugging Face writes
// them.
#pragma once

#include <filesystem>
#include <string>

#include "freetalk/speech/encoder.h"

namespace freetalk::speech {

/// Options from the text of a Hugging Face `config.json`. Keys that do not shape the network are
/// passed over.
/// @param where names the file in messages
/// @throws std::runtime_error for another architecture or a feature this encoder lacks (adapters,
/// batch norm)
SpeechEncoderOptions options_from_config(const std::string& json, const std::string& where);

/// Reads `dir`/config.json and `dir`/model.safetensors (or the shards of
/// model.safetensors.index.json). Names may carry a prefix "hubert." or "wav2vec2."; weight norm
/// may be spelt `weight_g`/`weight_v` or `parametrizations.weight.original0/1`; heads and
/// quantisers of pre-training or recognition checkpoints and `masked_spec_embed` are passed over.
/// Half precision becomes float32. The encoder comes in evaluation mode.
/// @throws std::runtime_error naming the file and every missing, unexpected or misshaped tensor
SpeechEncoder load_speech_encoder(const std::filesystem::path& dir);

/// Writes a folder that load_speech_encoder and `transformers` read. The weights carry a copy of
/// config.json: a stop between the two files leaves a folder that reads as the new encoder.
/// @param half store float16 (half the size, relative error below 5e-4 per weight)
/// @param extra_json a JSON object whose entries go into config.json too, such as how the weights
/// were trained
void save_speech_encoder(const SpeechEncoder& encoder, const std::filesystem::path& dir,
                         bool half = false, const std::string& extra_json = "{}");

}  // namespace freetalk::speech
