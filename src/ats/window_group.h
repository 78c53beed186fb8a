// Some neighbouring windows of a long motion, denoised together.
#pragma once

#include <ATen/core/Generator.h>
#include <ATen/core/Tensor.h>

#include <vector>

#include "ats/inference.h"
#include "freetalk/ats/generate.h"

namespace freetalk::ats {

/// (204,) factor of the noise of each coordinate, see GenerateOptions::mouth_temperature.
at::Tensor noise_amount(const GenerateOptions& options, const at::Tensor& like);

/// What a group leaves to the next for the frames that both hold; a tensor a step.
struct Shared {
  int64_t num_frames = 0;
  std::vector<at::Tensor> x0;     // (K, frames, 204) predictions times their weights
  at::Tensor weight;              // (frames, 1)
  std::vector<at::Tensor> noise;  // (K, frames, 204), of stochastic samplers
};

/// The windows of a motion and the groups they form.
struct WindowPlan {
  int64_t window = 0;                        // frames of each
  std::vector<std::vector<int64_t>> groups;  // first frames of each group's windows
  int64_t first_frame(size_t group) const { return groups[group].front(); }
  int64_t num_frames(size_t group) const {
    return groups[group].back() + window - first_frame(group);
  }
  /// Frames that a group shares with the next one; 0 for the last.
  int64_t shared_frames(size_t group) const;
};
WindowPlan plan_windows(int64_t num_frames, int64_t max_frames, const GenerateOptions& options);

/// Denoises the frames of one group.
class WindowGroup {
 public:
  /// @param starts of the windows, relative to the group's first frame. @param audio (frames, C).
  /// @param affect its weights (frames, K). @param before what the group before left.
  /// @param shared_after frames to leave to the next group. @param known first frames of every
  /// window that are given clean, see Condition::known.
  WindowGroup(AtsInference& network, const WindowPlan& plan, std::vector<int64_t> starts,
              const at::Tensor& audio, const Affect& affect, const GenerateOptions& options,
              Shared before, int64_t shared_after, int64_t known = 0);

  /// The cross-faded, guided estimate of x_0; call it once a step. @param x (K, frames, 204).
  at::Tensor denoise(const at::Tensor& x, int64_t timestep);
  /// Noise of one step, equal to that of the group before where both hold frames.
  at::Tensor draw(const at::Tensor& like, std::vector<at::Generator>& generators);
  Shared leave() { return std::move(after_); }

 private:
  at::Tensor guided(const at::Tensor& windows, int64_t timestep) const;

  AtsInference& network_;
  GenerateOptions options_;
  std::vector<int64_t> starts_;
  int64_t window_;
  std::vector<AtsInference::Variant> variants_;
  std::vector<at::Tensor> variant_weights_;  // broadcastable to (W, T, 1)
  AtsInference::Prepared prepared_;
  at::Tensor fade_, total_;  // (window, 1), (frames, 1)
  Shared before_, after_;
  size_t step_ = 0, draw_ = 0;
};

}  // namespace freetalk::ats
