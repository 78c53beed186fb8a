// DiffusionNet [Sharp, Attaiki, Crane, Ovsjanikov 2022]: learned heat diffusion on a surface, for
// many frames at once.
//
//   x_d = Phi exp(-lambda t) Phi^T M x,  g = (G_x x_d, G_y x_d),  z = tanh(Re(conj(g) A g)),
//   block(x) = x + MLP([x, x_d, z]).
//
// Names equal the public diffusion_net package's, so its checkpoints load.
#pragma once

#include <torch/nn/module.h>
#include <torch/nn/modules/linear.h>
#include <torch/nn/pimpl.h>

#include <string>
#include <vector>

#include "freetalk/geometry/operators.h"

namespace freetalk::nn {

struct DiffusionNetOptions {
  int64_t in_channels = 6;
  int64_t out_channels = 128;
  int64_t width = 128;  // C
  int64_t num_blocks = 4;
  double dropout =
      0.0;  // 0.5 in the public package; before every linear of a block's MLP but the first
  template <class V>
  void fields(V& v) {
    v("in_channels", in_channels);
    v("out_channels", out_channels);
    v("width", width);
    v("num_blocks", num_blocks);
    v("dropout", dropout);
  }
  void check() const;
};

/// Diffusion of each channel for a learned time, in the spectral basis.
class LearnedDiffusionImpl : public torch::nn::Module {
 public:
  explicit LearnedDiffusionImpl(int64_t channels);
  /// @param x (B, V, C). @returns (B, V, C).
  at::Tensor forward(const at::Tensor& x, const geometry::SurfaceOperators& operators);

 private:
  at::Tensor diffusion_time_;
};
TORCH_MODULE(LearnedDiffusion);

/// tanh of the products of gradients with their rotated, scaled selves.
class GradientFeaturesImpl : public torch::nn::Module {
 public:
  explicit GradientFeaturesImpl(int64_t channels);
  /// @param gradients (B, 2V, C): all x components, then all y. @returns (B, V, C).
  at::Tensor forward(const at::Tensor& gradients);

 private:
  torch::nn::Linear a_re_{nullptr}, a_im_{nullptr};
};
TORCH_MODULE(GradientFeatures);

class DiffusionNetBlockImpl : public torch::nn::Module {
 public:
  DiffusionNetBlockImpl(int64_t channels, double dropout);
  at::Tensor forward(const at::Tensor& x, const geometry::SurfaceOperators& operators);

 private:
  double dropout_;
  LearnedDiffusion diffusion_{nullptr};
  GradientFeatures gradient_features_{nullptr};
  std::vector<torch::nn::Linear> mlp_;
};
TORCH_MODULE(DiffusionNetBlock);

class DiffusionNetImpl : public torch::nn::Module {
 public:
  explicit DiffusionNetImpl(const DiffusionNetOptions& options);

  /// @param x (B, V, in_channels) values at the vertices of one mesh. @returns (B, V,
  /// out_channels).
  at::Tensor forward(const at::Tensor& x, const geometry::SurfaceOperators& operators);
  /// What follows the first linear layer: for callers that compute it in parts. @param hidden (B,
  /// V, width).
  at::Tensor forward_hidden(const at::Tensor& hidden, const geometry::SurfaceOperators& operators);

  const DiffusionNetOptions& options() const { return options_; }
  torch::nn::Linear first_lin{nullptr}, last_lin{nullptr};

 private:
  DiffusionNetOptions options_;
  std::vector<DiffusionNetBlock> blocks_;
};
TORCH_MODULE(DiffusionNet);

}  // namespace freetalk::nn
