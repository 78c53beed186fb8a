// The denoiser of FaceTalkImpl::forward for sampling piece by piece: what does not depend on the
// step (what is heard), on the frames (what a step says) or on later frames (keys and values of the
// past) is computed once. Equal to forward in eval mode up to rounding.
#pragma once

#include <ATen/core/Tensor.h>

#include <unordered_map>
#include <vector>

#include "freetalk/facetalk/facetalk.h"

namespace freetalk::facetalk {

class Inference {
 public:
  /// @param timesteps those that will be asked for. @param guidance w; 1: no unconditional pass.
  /// @param dtype that the network computes in: float32 or bfloat16.
  Inference(FaceTalk model, const std::vector<int64_t>& timesteps, double guidance,
            at::ScalarType dtype);

  /// Makes these the frames to denoise, after those of the calls before.
  /// @param features (n, C). @param num_motions K that share them.
  void hear(const at::Tensor& features, int64_t num_motions);

  /// Once for each timestep and piece. @param x (K, n, code_dim) noisy normalised codes.
  /// @returns (K, n, code_dim) float32, the guided estimates of x_0.
  at::Tensor denoise(const at::Tensor& x, int64_t timestep);

  void reset();
  int64_t num_held() const;

 private:
  struct Step {
    at::Tensor code;  // (1, d)
    std::vector<nn::PlaceTerms> terms;
    std::vector<nn::PastFrames> past;
  };

  FaceTalk model_;
  double guidance_;
  at::ScalarType dtype_;
  std::unordered_map<int64_t, Step> steps_;
  int64_t next_ = 0;  // first frame that was not heard yet
  std::vector<at::Tensor> heard_;
  at::Tensor positions_;
  nn::CausalSpan span_;
};

}  // namespace freetalk::facetalk
