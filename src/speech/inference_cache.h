// When the fast way through the encoder may be taken, and the weights it has prepared.
#pragma once

#include <torch/nn/module.h>

#include <memory>
#include <mutex>
#include <optional>
#include <vector>

#include "fast_scope.h"
#include "inference.h"

namespace freetalk::speech {

class SpeechEncoderImpl;

/// The type of the products if `input` and the parameters of `module` can take the fast way: on a
/// CPU, float32 or bfloat16, nothing to differentiate, no dropout at work.
std::optional<at::ScalarType> fast_dtype(const at::Tensor& input, const torch::nn::Module& module,
                                         bool has_dropout);

/// Lengths of B clips on the host; `whole` each when `lengths` is nothing.
std::vector<int64_t> host_lengths(const std::optional<at::Tensor>& lengths, int64_t num_clips,
                                  int64_t whole);

/// Keeps the last InferenceEncoder while the parameters stay as they were.
class InferenceCache {
 public:
  std::shared_ptr<const InferenceEncoder> get(const SpeechEncoderImpl& encoder,
                                              at::ScalarType dtype);
  void clear();

 private:
  /// What changes when a parameter does: where it lies, how often it was written to, and some of
  /// its bytes, for writes through `.data` that are not counted.
  struct Stamp {
    const void* data = nullptr;
    uint64_t version = 0, sample = 0;
    bool operator==(const Stamp&) const = default;
  };
  static Stamp stamp(const at::Tensor& tensor);

  std::mutex mutex_;
  at::ScalarType dtype_ = at::kFloat;
  std::vector<Stamp> stamps_;
  std::shared_ptr<const InferenceEncoder> network_;
};

}  // namespace freetalk::speech
