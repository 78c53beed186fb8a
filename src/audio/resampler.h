// libsamplerate's best sinc converter, block by block.
#pragma once

#include <samplerate.h>

#include <cstdint>
#include <memory>
#include <vector>

namespace freetalk::audio {

/// Feeds blocks, appends what comes out; `finish` flushes and fixes the length to resampled_size().
class Resampler {
 public:
  Resampler(int64_t from_hz, int64_t to_hz);
  /// Appends the output of `count` further samples to `result`.
  void push(const float* samples, int64_t count, std::vector<float>& result);
  /// The rest of the output; `result` ends with exactly resampled_size(everything pushed) samples
  /// of this clip.
  void finish(std::vector<float>& result);

 private:
  void process(const float* samples, int64_t count, bool last, std::vector<float>& result);

  struct Release {
    void operator()(SRC_STATE* state) const { src_delete(state); }
  };
  std::unique_ptr<SRC_STATE, Release> state_;  // null when the rates agree
  int64_t from_hz_, to_hz_;
  int64_t num_pushed_ = 0;
  std::vector<float> block_;
};

}  // namespace freetalk::audio
