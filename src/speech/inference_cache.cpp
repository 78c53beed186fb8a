#include "inference_cache.h"

#include <ATen/TensorSubclassLikeUtils.h>
#include <ATen/autocast_mode.h>
#include <torch/torch.h>

#include <algorithm>
#include <cstring>

#include "freetalk/core/module_io.h"
#include "freetalk/speech/encoder.h"

namespace freetalk::speech {
namespace {

bool is_plain_on_cpu(const at::Tensor& tensor) {
  return tensor.is_cpu() && tensor.layout() == at::kStrided && !at::isTensorSubclassLike(tensor);
}

}  // namespace

std::optional<at::ScalarType> fast_dtype(const at::Tensor& input, const torch::nn::Module& module,
                                         bool has_dropout) {
  const auto parameters = module.parameters();
  const auto dtype = parameters.front().scalar_type();
  const bool differentiate =
      at::GradMode::is_enabled() &&
      (input.requires_grad() || std::any_of(parameters.begin(), parameters.end(),
                                            [](const auto& p) { return p.requires_grad(); }));
  if (differentiate || (has_dropout && module.is_training()) || !is_plain_on_cpu(input) ||
      !std::all_of(parameters.begin(), parameters.end(), [&](const auto& p) {
        return is_plain_on_cpu(p) && p.scalar_type() == dtype && p.is_contiguous();
      })) {
    return std::nullopt;
  }
  const bool autocast = at::autocast::is_autocast_enabled(at::kCPU);
  const auto compute = autocast ? at::autocast::get_autocast_dtype(at::kCPU) : dtype;
  const bool same_type = input.scalar_type() == dtype || (autocast && dtype == at::kFloat);
  if (!same_type || (dtype != at::kFloat && dtype != at::kBFloat16) ||
      !kernels::has_onednn(at::kFloat) || !kernels::has_onednn(compute)) {
    return std::nullopt;
  }
  return compute;
}

std::vector<int64_t> host_lengths(const std::optional<at::Tensor>& lengths, int64_t num_clips,
                                  int64_t whole) {
  if (!lengths) {
    return std::vector<int64_t>(static_cast<size_t>(num_clips), whole);
  }
  const auto host = lengths->to(at::kCPU, at::kLong).contiguous();
  std::vector<int64_t> result(host.const_data_ptr<int64_t>(),
                              host.const_data_ptr<int64_t>() + host.numel());
  for (auto& length : result) {
    length = std::clamp<int64_t>(length, 0, whole);
  }
  return result;
}

InferenceCache::Stamp InferenceCache::stamp(const at::Tensor& tensor) {
  constexpr size_t kSamples = 16;
  const auto* bytes = static_cast<const char*>(tensor.const_data_ptr());
  const size_t words = tensor.nbytes() / sizeof(uint32_t);
  uint64_t hash = 14695981039346656037ULL;  // FNV-1a
  for (size_t i = 0; i < std::min(words, kSamples); ++i) {
    uint32_t word = 0;
    std::memcpy(&word, bytes + i * words / std::min(words, kSamples) * sizeof word, sizeof word);
    hash = (hash ^ word) * 1099511628211ULL;
  }
  return {tensor.const_data_ptr(),
          tensor.is_inference() ? 0U : static_cast<uint64_t>(tensor._version()), hash};
}

std::shared_ptr<const InferenceEncoder> InferenceCache::get(const SpeechEncoderImpl& encoder,
                                                            at::ScalarType dtype) {
  std::vector<Stamp> stamps;
  for (const auto& parameter : encoder.parameters()) {
    stamps.push_back(stamp(parameter));
  }
  const std::lock_guard lock(mutex_);
  if (!network_ || dtype != dtype_ || stamps != stamps_) {
    network_.reset();  // before another copy of the weights is made
    const c10::InferenceMode plain_tensors(false);
    network_ =
        std::make_shared<InferenceEncoder>(encoder.options(), core::state_of(encoder), dtype);
    dtype_ = dtype;
    stamps_ = std::move(stamps);
  }
  return network_;
}

void InferenceCache::clear() {
  const std::lock_guard lock(mutex_);
  network_.reset();
}

}  // namespace freetalk::speech
