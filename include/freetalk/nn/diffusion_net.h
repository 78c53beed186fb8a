// DiffusionNet [Sharp, Attaiki, Crane, Ovsjanikov 2022]: learned heat diffusion on a surface, for
// many frames at once.
//
//   x_d = Phi exp(-lambda t) Phi^T M x,  g = (G_x x_d, G_y x_d),  z = tanh(Re(conj(g) A g)),
//   block(x) = x + MLP([x, x_d, z]).
//
// Names equal the public diffusion_net package's, so its checkpoints load.
#pragma once

#include <torch/nn/pimpl.h>

#include <string>
#include <vector>

#include "freetalk/nn/surface_net.h"

namespace freetalk::nn {

struct DiffusionNetOptions {
  int64_t in_channels = 6;
  int64_t out_channels = 128;
  int64_t width = 128;  // C
  int64_t num_blocks = 4;
  double dropout =
      0.0;  // 0.5 in the public package; before every linear of a block's MLP but the first
  std::vector<int64_t> mlp_hidden = {};  // widths of the blocks' MLPs; empty: {width, width}
  std::string outputs_at = "vertices";   // "vertices", "edges", "faces" or "global_mean"
  // "spectral", or "implicit_dense": one implicit Euler step a channel, which needs no eigenbasis.
  std::string diffusion_method = "spectral";
  bool with_gradient_features = true;
  bool with_gradient_rotations = true;  // false for surfaces without a consistent orientation
  template <class V>
  void fields(V& v) {
    v("in_channels", in_channels);
    v("out_channels", out_channels);
    v("width", width);
    v("num_blocks", num_blocks);
    v("dropout", dropout);
    v("mlp_hidden", mlp_hidden);
    v("outputs_at", outputs_at);
    v("diffusion_method", diffusion_method);
    v("with_gradient_features", with_gradient_features);
    v("with_gradient_rotations", with_gradient_rotations);
  }
  void check() const;
};

/// Diffusion of each channel for a learned time, in the spectral basis or by one implicit step.
class LearnedDiffusionImpl : public torch::nn::Module {
 public:
  explicit LearnedDiffusionImpl(int64_t channels, bool spectral = true);
  /// @param x (B, V, C). @returns (B, V, C).
  at::Tensor forward(const at::Tensor& x, const geometry::SurfaceOperators& operators);
  /// (C,) as every forward pass takes it: at least 1e-8. The parameter stays as it is.
  at::Tensor time();

 private:
  bool spectral_;
  at::Tensor diffusion_time_;
};
TORCH_MODULE(LearnedDiffusion);

/// tanh of the products of gradients with their rotated, scaled selves.
class GradientFeaturesImpl : public torch::nn::Module {
 public:
  explicit GradientFeaturesImpl(int64_t channels, bool rotations = true);
  /// @param gradients (B, 2V, C): all x components, then all y. @returns (B, V, C).
  at::Tensor forward(const at::Tensor& gradients);

  torch::nn::Linear a_re{nullptr}, a_im{nullptr};  // a_im is null without rotations
};
TORCH_MODULE(GradientFeatures);

class DiffusionNetBlockImpl : public torch::nn::Module {
 public:
  explicit DiffusionNetBlockImpl(const DiffusionNetOptions& options);
  at::Tensor forward(const at::Tensor& x, const geometry::SurfaceOperators& operators);

  LearnedDiffusion diffusion{nullptr};
  GradientFeatures gradient_features{nullptr};  // null without gradient features
  std::vector<torch::nn::Linear> mlp;

 private:
  double dropout_;
};
TORCH_MODULE(DiffusionNetBlock);

class DiffusionNetImpl : public SurfaceNetImpl {
 public:
  explicit DiffusionNetImpl(const DiffusionNetOptions& options);

  /// @returns (B, V, out_channels), or (B, E, ...) at the edges of geometry::unique_edges, (B, F,
  ///   ...) at the faces, (B, meshes, ...) for the mass-weighted mean of each mesh.
  at::Tensor forward_hidden(const at::Tensor& hidden,
                            const geometry::SurfaceOperators& operators) override;
  torch::nn::Linear& first_layer() override { return first_lin; }
  torch::nn::Linear& last_layer() override { return last_lin; }
  bool uses_eigenbasis() const override { return options_.diffusion_method == "spectral"; }

  const DiffusionNetOptions& options() const { return options_; }
  const std::vector<DiffusionNetBlock>& blocks() const { return blocks_; }
  torch::nn::Linear first_lin{nullptr}, last_lin{nullptr};

 private:
  DiffusionNetOptions options_;
  std::vector<DiffusionNetBlock> blocks_;
};
TORCH_MODULE(DiffusionNet);

}  // namespace freetalk::nn
