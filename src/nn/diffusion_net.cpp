#include "freetalk/nn/diffusion_net.h"

#include <torch/torch.h>

#include "freetalk/core/error.h"
#include "freetalk/nn/sparse.h"

namespace freetalk::nn {
namespace {

constexpr double kMinDiffusionTime = 1e-8;  // as in the public package, at every forward

}  // namespace

void DiffusionNetOptions::check() const {
  FREETALK_CHECK(in_channels > 0 && out_channels > 0 && width > 0 && num_blocks > 0,
                 "DiffusionNet: channels, width and num_blocks must be positive");
  FREETALK_CHECK(dropout >= 0 && dropout < 1, "DiffusionNet: dropout must be in [0, 1), found ",
                 dropout);
}

LearnedDiffusionImpl::LearnedDiffusionImpl(int64_t channels) {
  diffusion_time_ = register_parameter("diffusion_time", torch::zeros({channels}));
}

at::Tensor LearnedDiffusionImpl::forward(const at::Tensor& x,
                                         const geometry::SurfaceOperators& operators) {
  {
    const torch::NoGradGuard no_grad;
    diffusion_time_.clamp_(kMinDiffusionTime);
  }
  const at::Tensor weighted_basis =
      (operators.evecs * operators.mass.unsqueeze(1)).t();  // (K, V): Phi^T M
  const at::Tensor spectrum = weighted_basis.matmul(x);     // (B, K, C)
  const at::Tensor decay =
      at::exp(-operators.evals.unsqueeze(1) * diffusion_time_.unsqueeze(0));  // (K, C)
  return operators.evecs.matmul(spectrum * decay);
}

GradientFeaturesImpl::GradientFeaturesImpl(int64_t channels) {
  const auto options = torch::nn::LinearOptions(channels, channels).bias(false);
  a_re_ = register_module("A_re", torch::nn::Linear(options));
  a_im_ = register_module("A_im", torch::nn::Linear(options));
}

at::Tensor GradientFeaturesImpl::forward(const at::Tensor& gradients) {
  const int64_t vertices = gradients.size(1) / 2;
  const at::Tensor gx = gradients.narrow(1, 0, vertices),
                   gy = gradients.narrow(1, vertices, vertices);
  const auto re = a_re_(gradients).split(vertices, 1);
  const auto im = a_im_(gradients).split(vertices, 1);
  return at::tanh(gx * (re[0] - im[1]) + gy * (re[1] + im[0]));
}

DiffusionNetBlockImpl::DiffusionNetBlockImpl(int64_t channels, double dropout) : dropout_(dropout) {
  diffusion_ = register_module("diffusion", LearnedDiffusion(channels));
  gradient_features_ = register_module("gradient_features", GradientFeatures(channels));
  auto mlp = register_module("mlp", std::make_shared<torch::nn::Module>());
  const int64_t widths[] = {3 * channels, channels, channels, channels};
  for (int layer = 0; layer < 3; ++layer) {
    mlp_.push_back(mlp->register_module("miniMLP_mlp_layer_00" + std::to_string(layer),
                                        torch::nn::Linear(widths[layer], widths[layer + 1])));
  }
}

at::Tensor DiffusionNetBlockImpl::forward(const at::Tensor& x,
                                          const geometry::SurfaceOperators& operators) {
  const at::Tensor diffused = diffusion_(x, operators);
  const at::Tensor gradients =
      sparse_product(operators.gradients, operators.gradients_transposed, diffused);
  at::Tensor y = mlp_[0](at::cat({x, diffused, gradient_features_(gradients)}, -1));
  for (size_t layer = 1; layer < mlp_.size(); ++layer) {
    y = mlp_[layer](at::dropout(at::relu(y), dropout_, is_training()));
  }
  return x + y;
}

DiffusionNetImpl::DiffusionNetImpl(const DiffusionNetOptions& options) : options_(options) {
  options.check();
  first_lin = register_module("first_lin", torch::nn::Linear(options.in_channels, options.width));
  last_lin = register_module("last_lin", torch::nn::Linear(options.width, options.out_channels));
  for (int64_t index = 0; index < options.num_blocks; ++index) {
    blocks_.push_back(register_module("block_" + std::to_string(index),
                                      DiffusionNetBlock(options.width, options.dropout)));
  }
}

at::Tensor DiffusionNetImpl::forward(const at::Tensor& x,
                                     const geometry::SurfaceOperators& operators) {
  FREETALK_CHECK(
      x.dim() == 3 && x.size(1) == operators.mass.size(0) && x.size(2) == options_.in_channels,
      "DiffusionNet: expected x (B, ", operators.mass.size(0), ", ", options_.in_channels,
      "), found ", x.sizes());
  return forward_hidden(first_lin(x), operators);
}

at::Tensor DiffusionNetImpl::forward_hidden(const at::Tensor& hidden,
                                            const geometry::SurfaceOperators& operators) {
  at::Tensor x = hidden;
  for (DiffusionNetBlock& block : blocks_) x = block(x, operators);
  return last_lin(x);
}

}  // namespace freetalk::nn
