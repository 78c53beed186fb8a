// The denoiser of AtsImpl::forward for sampling: called many times under one condition, so weights
// are packed, and everything that does not depend on the noisy motion is computed, once. Equal to
// forward in eval mode up to rounding.
#pragma once

#include <ATen/core/Tensor.h>

#include <unordered_map>
#include <vector>

#include "freetalk/ats/ats.h"
#include "freetalk/ats/emotion.h"
#include "nn/decoder_inference.h"

namespace freetalk::ats {

class AtsInference {
 public:
  /// @param timesteps those that will be asked for.
  /// @param dtype of the network: float32 or bfloat16; positions, codes and results are float32.
  /// @param rows frames a call usually denoises, over all windows.
  AtsInference(AtsImpl& model, const std::vector<int64_t>& timesteps, at::ScalarType dtype,
               int64_t rows);

  /// A condition of the network; the null ones serve guidance.
  struct Variant {
    bool null_audio = false;
    int64_t affect = 0;  // index of an emotion; their number K: the null affect
  };
  /// What does not depend on the step, for W windows of T frames.
  struct Prepared {
    nn::BandAttention band;
    at::Tensor base;    // (K + 1, T, d): positions and the code of each affect, then the null one
    int64_t known = 0;  // first frames, whose base also holds the code of timestep 0
    std::vector<at::Tensor>
        memory;  // of each layer (2 W, T + 2 margin, 2d): audio; then null audio
  };

  /// @param audio (W, T, C). @param affect its K emotions and intensities.
  /// @param null_audio whether variants with null audio will be asked for.
  /// @param known first frames of every window that are given clean, see Condition::known.
  Prepared prepare(const at::Tensor& audio, const Affect& affect, bool null_audio,
                   int64_t known = 0);

  /// @param x (G, W, T, 204) noisy normalised displacements of G groups of W windows.
  /// @param variants of each group. @returns (G, W, T, 204) float32, the estimates of x_0.
  at::Tensor denoise(const at::Tensor& x, int64_t timestep, const Prepared& prepared,
                     const std::vector<Variant>& variants) const;

 private:
  AtsImpl& model_;
  at::ScalarType dtype_;
  std::unordered_map<int64_t, at::Tensor> time_codes_;  // (d,) of each timestep
  kernels::FixedLinear input_, output_;
  std::vector<nn::DecoderLayerInference> layers_;
};

}  // namespace freetalk::ats
