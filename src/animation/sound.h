// The speech inside and beside animation files.
#pragma once

#include <filesystem>
#include <string>

#include "freetalk/audio/audio.h"

namespace freetalk::animation {

/// A 16-bit WAV file.
std::string wav_bytes(const audio::Audio& audio);
/// What wav_bytes() made; no samples for anything else.
audio::Audio parse_wav(const std::string& bytes);

/// "talk.speech.wav" for "talk.glb": not the name of a recording that the user may have there.
std::filesystem::path sound_beside(const std::filesystem::path& path);

}  // namespace freetalk::animation
