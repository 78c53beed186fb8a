// What a user chooses: about a face, about a performance.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace freetalk::talker {

/// What the face feels at one moment.
struct EmotionKey {
  double time_s = 0.0;
  std::map<std::string, double> mixture = {{"neutral", 1.0}};  // shares, in proportion; aliases too
  std::optional<double> intensity;                             // nothing: AnimateOptions::intensity
};

/// Keys as the text that the string language has for them; numbers come back exactly.
/// @throws std::invalid_argument for no keys, or a name that the language cannot hold.
std::string emotion_text(const std::vector<EmotionKey>& keys);

/// How a face is prepared: what depends on the mesh alone.
struct FaceOptions {
  std::string unit = "auto";  // of the mesh, see geometry::AlignOptions
  std::string up = "auto";
  std::string forward = "auto";
  /// What moves the surface: "stm", or, where the weights hold one, "head": the parametric head
  /// that fits the mesh best.
  std::string engine = "stm";
  std::string precision = "float32";  // of ATS and STM: "float32" or "bfloat16" (faster, coarser)
  int64_t memory_mb = 256;            // working memory of decoding, beside the result
  /// "yes": the surface follows the landmarks where they are on the mesh (stm/landmark_follower.h);
  /// "no": it moves as the engine has it; "auto": as STM's weights say, and always with "head".
  std::string follow_landmarks = "auto";
  /// Folder that keeps what is computed of a mesh for the next time; "auto":
  /// geometry::default_cache_dir(). Nothing, the default here: no file is read or written. (Python
  /// and the command line ask for "auto".)
  std::optional<std::string> cache_dir;

  template <class V>
  void fields(V& v) {
    v("unit", unit);
    v("up", up);
    v("forward", forward);
    v("engine", engine);
    v("precision", precision);
    v("memory_mb", memory_mb);
    v("follow_landmarks", follow_landmarks);
    v("cache_dir", cache_dir);
  }
  /// @throws std::invalid_argument naming the option at fault.
  void check() const;
};

/// One performance. Options without a value are as the weights say.
struct AnimateOptions {
  /// A name, an alias ("fear"), a mixture "happy:0.7,sad:0.3", or keys over time
  /// "0=neutral; 2.5=happy:0.7,surprise:0.3@2.5" (seconds=emotion@intensity; linear in between).
  /// For keys as values: emotion_text().
  std::string emotion = "neutral";
  /// 1 (slight) ... AtsOptions::num_intensities (strong); nothing: the middle. Neutral has one.
  std::optional<double> intensity;
  /// What makes motion of speech: "ats", or, where the weights hold it, "facetalk", which knows no
  /// emotions.
  std::string motion = "ats";
  double fps = 30.0;                        // frames per second of the animation, 0 < fps <= 240
  int64_t seed = 0;                         // other seeds give other motion for the same speech
  std::optional<std::string> sampler;       // "ddim", "ddpm", "renoise", "dpmpp"
  std::optional<int64_t> num_steps;         // denoising steps; 20 of another "dpmpp", 50 else
  std::optional<double> eta;                // DDIM noise in [0, 1]
  std::optional<double> audio_guidance;     // see ats::GenerateOptions
  std::optional<double> affect_guidance;    // see ats::GenerateOptions
  std::optional<double> mouth_temperature;  // see ats::GenerateOptions
  /// How far the mouth goes, in [0.5, 1.5]: below 1 mumbled, above 1 exaggerated, see
  /// ats::articulate(). 1: as far as recorded mouths.
  double articulation = 1.0;
  bool blinks = true;        // also blink where the model leaves the eyes open for long
  bool head_motion = false;  // small motion of the head, as Animation::head; see head_motion()
  /// Largest error of frames that are interpolated instead of decoded, see stm::AdaptiveOptions; 0:
  /// every frame is decoded.
  double tolerance_mm = 0.2;
  /// Folder for a nameless temporary file that holds a result of 64 MB and more in place of memory.
  std::optional<std::string> scratch_dir;

  template <class V>
  void fields(V& v) {
    v("emotion", emotion);
    v("intensity", intensity);
    v("motion", motion);
    v("fps", fps);
    v("seed", seed);
    v("sampler", sampler);
    v("num_steps", num_steps);
    v("eta", eta);
    v("audio_guidance", audio_guidance);
    v("affect_guidance", affect_guidance);
    v("mouth_temperature", mouth_temperature);
    v("articulation", articulation);
    v("blinks", blinks);
    v("head_motion", head_motion);
    v("tolerance_mm", tolerance_mm);
    v("scratch_dir", scratch_dir);
  }
  /// @throws std::invalid_argument naming the option at fault (emotions and intensities are checked
  /// against the weights').
  void check() const;
};

/// Both, for the one call that does everything.
struct TalkerOptions : AnimateOptions, FaceOptions {
  template <class V>
  void fields(V& v) {
    AnimateOptions::fields(v);
    FaceOptions::fields(v);
  }
  void check() const;
};

}  // namespace freetalk::talker
