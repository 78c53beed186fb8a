// PoissonNet [Maesumi et al. 2025]: learned transformations of gradients, and the functions that
// fit them best, found by a Poisson solve: local and global at once, without an eigenbasis.
//
//   g = ComplexMLP(G x, x at the faces),  u = L^-1 G^T A g minus its area-weighted mean,
//   y = x + ls1 * MLP1([x, u]),  block(x) = y + ls2 * MLP2(y).
//
// L = G^T A G + 1e-6 I. Names equal the public package's, so its checkpoints load (those with the
// head "linear").
#pragma once

#include <torch/nn/pimpl.h>

#include <vector>

#include "freetalk/nn/surface_net.h"

namespace freetalk::nn {

struct PoissonNetOptions {
  int64_t in_channels = 6;
  int64_t out_channels = 128;
  int64_t width = 128;  // C
  int64_t num_blocks = 4;
  double dropout = 0.0;            // inside the blocks' MLPs
  int64_t num_complex_layers = 2;  // of the complex MLP on gradients
  bool modulate = true;            // turn and scale gradients by what the scalar features say
  bool gradient_products = false;  // add inner products of gradients to MLP1's input
  template <class V>
  void fields(V& v) {
    v("in_channels", in_channels);
    v("out_channels", out_channels);
    v("width", width);
    v("num_blocks", num_blocks);
    v("dropout", dropout);
    v("num_complex_layers", num_complex_layers);
    v("modulate", modulate);
    v("gradient_products", gradient_products);
  }
  void check() const;
};

/// Vectors on the faces as complex numbers, (B, F, C) each.
struct ComplexPair {
  at::Tensor re, im;
};

/// A complex-linear layer; with `nonlinear`, z <- GELU(|z| + bias) z / |z|.
class ComplexLayerImpl : public torch::nn::Module {
 public:
  ComplexLayerImpl(int64_t in_channels, int64_t out_channels, bool nonlinear);
  ComplexPair forward(const ComplexPair& x);

 private:
  torch::nn::Linear lin_real_{nullptr}, lin_imag_{nullptr};
  at::Tensor mag_bias_;
};
TORCH_MODULE(ComplexLayer);

/// Layers of complex numbers, after a rotation and scaling of each channel by a function of
/// scalars.
class ComplexMlpImpl : public torch::nn::Module {
 public:
  ComplexMlpImpl(int64_t channels, int64_t num_layers, bool modulate);
  /// @param scalars (B, F, C) features at the faces.
  ComplexPair forward(const ComplexPair& gradients, const at::Tensor& scalars);

 private:
  torch::nn::Linear phase_in_{nullptr}, phase_out_{nullptr};
  std::vector<ComplexLayer> layers_;
};
TORCH_MODULE(ComplexMlp);

class PoissonBlockImpl : public torch::nn::Module {
 public:
  explicit PoissonBlockImpl(const PoissonNetOptions& options);
  /// @param x (B, V, C). @returns (B, V, C).
  at::Tensor forward(const at::Tensor& x, const geometry::SurfaceOperators& operators);

 private:
  at::Tensor mlp(std::vector<torch::nn::Linear>& layers, const at::Tensor& x);

  double dropout_;
  ComplexMlp grad_mlp_{nullptr};
  ComplexLayer grad_features_{nullptr};
  at::Tensor grad_scaler_, ls1_, ls2_;
  std::vector<torch::nn::Linear> mlp1_, mlp2_;
};
TORCH_MODULE(PoissonBlock);

class PoissonNetImpl : public SurfaceNetImpl {
 public:
  explicit PoissonNetImpl(const PoissonNetOptions& options);
  at::Tensor forward_hidden(const at::Tensor& hidden,
                            const geometry::SurfaceOperators& operators) override;
  torch::nn::Linear& first_layer() override { return proj_in_; }
  torch::nn::Linear& last_layer() override { return head_; }
  const PoissonNetOptions& options() const { return options_; }

 private:
  PoissonNetOptions options_;
  torch::nn::Linear proj_in_{nullptr}, head_{nullptr};
  std::vector<PoissonBlock> blocks_;
};
TORCH_MODULE(PoissonNet);

}  // namespace freetalk::nn
