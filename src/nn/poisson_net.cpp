#include "freetalk/nn/poisson_net.h"

#include <torch/torch.h>

#include "freetalk/core/error.h"
#include "freetalk/nn/poisson.h"
#include "nn/surface_means.h"

namespace freetalk::nn {
namespace {

constexpr double kMagnitudeFloor = 1e-8;  // of squares and of magnitudes, as in the public package
constexpr double kScaleFloor = 1e-8;
constexpr double kInitialProductScale = 1e-2;

using ModulePtr = std::shared_ptr<torch::nn::Module>;

/// Linear, GELU, dropout, linear under the public package's names.
std::vector<torch::nn::Linear> register_mlp(torch::nn::Module& parent, const char* name,
                                            int64_t in_channels, int64_t width) {
  const ModulePtr mlp = parent.register_module(name, std::make_shared<torch::nn::Module>());
  const ModulePtr layers = mlp->register_module("layers", std::make_shared<torch::nn::Module>());
  return {layers->register_module("0", torch::nn::Linear(in_channels, width)),
          layers->register_module("3", torch::nn::Linear(width, width))};
}

/// Area-weighted mean of values at the faces over the faces around each vertex.
at::Tensor faces_to_vertices(const at::Tensor& x, const geometry::FaceOperators& faces) {
  const at::Tensor corners = faces.faces.flatten();
  const int64_t vertices = faces.components.size(0);
  const at::Tensor weights = faces.areas.to(x.scalar_type()).repeat_interleave(3).view({1, -1, 1});
  const auto add = [&](const at::Tensor& values) {
    return at::zeros({values.size(0), vertices, values.size(2)}, values.options())
        .index_add(1, corners, values);
  };
  const at::Tensor total = add(weights);
  return add(x.repeat_interleave(3, 1) * weights) / total.masked_fill(total == 0, 1);
}

}  // namespace

void PoissonNetOptions::check() const {
  FREETALK_CHECK(
      in_channels > 0 && out_channels > 0 && width > 0 && num_blocks > 0 && num_complex_layers > 0,
      "PoissonNet: channels, width, num_blocks and num_complex_layers must be positive");
  FREETALK_CHECK(dropout >= 0 && dropout < 1, "PoissonNet: dropout must be in [0, 1), found ",
                 dropout);
}

ComplexLayerImpl::ComplexLayerImpl(int64_t in_channels, int64_t out_channels, bool nonlinear) {
  const auto options = torch::nn::LinearOptions(in_channels, out_channels).bias(false);
  lin_real_ = register_module("lin_real", torch::nn::Linear(options));
  lin_imag_ = register_module("lin_imag", torch::nn::Linear(options));
  if (nonlinear) mag_bias_ = register_parameter("mag_bias", torch::zeros({out_channels}));
}

ComplexPair ComplexLayerImpl::forward(const ComplexPair& x) {
  const at::Tensor re = lin_real_(x.re) - lin_imag_(x.im), im = lin_real_(x.im) + lin_imag_(x.re);
  if (!mag_bias_.defined()) return {re, im};
  const at::Tensor magnitude = at::sqrt(re.square() + im.square() + kMagnitudeFloor);
  const at::Tensor scale = at::gelu(magnitude + mag_bias_) / (magnitude + kMagnitudeFloor);
  return {re * scale, im * scale};
}

ComplexMlpImpl::ComplexMlpImpl(int64_t channels, int64_t num_layers, bool modulate) {
  const ModulePtr layers = register_module("layers", std::make_shared<torch::nn::Module>());
  for (int64_t index = 0; index < num_layers; ++index) {
    layers_.push_back(layers->register_module(
        std::to_string(index), ComplexLayer(channels, channels, index + 1 < num_layers)));
  }
  if (!modulate) return;
  const ModulePtr outer = register_module("modulator", std::make_shared<torch::nn::Module>());
  const ModulePtr inner =
      outer->register_module("modulator", std::make_shared<torch::nn::Module>());
  phase_in_ = inner->register_module("0", torch::nn::Linear(channels, channels));
  phase_out_ = inner->register_module("2", torch::nn::Linear(channels, 2 * channels));
}

ComplexPair ComplexMlpImpl::forward(const ComplexPair& gradients, const at::Tensor& scalars) {
  ComplexPair z = gradients;
  if (phase_in_) {
    const auto parts = phase_out_(at::gelu(phase_in_(scalars))).chunk(2, -1);
    const at::Tensor scale = at::softplus(parts[1]) + kScaleFloor;
    const at::Tensor cosine = parts[0].cos() * scale, sine = parts[0].sin() * scale;
    z = {z.re * cosine - z.im * sine, z.re * sine + z.im * cosine};
  }
  for (ComplexLayer& layer : layers_) z = layer(z);
  return z;
}

PoissonBlockImpl::PoissonBlockImpl(const PoissonNetOptions& options) : dropout_(options.dropout) {
  const int64_t width = options.width;
  grad_mlp_ =
      register_module("grad_mlp", ComplexMlp(width, options.num_complex_layers, options.modulate));
  if (options.gradient_products) {
    grad_features_ = register_module("grad_features", ComplexLayer(width, width, false));
    grad_scaler_ = register_parameter("grad_scaler", torch::full({width}, kInitialProductScale));
  }
  const ModulePtr mlp = register_module("vert_mlp", std::make_shared<torch::nn::Module>());
  mlp1_ = register_mlp(*mlp, "mlp1", (options.gradient_products ? 3 : 2) * width, width);
  mlp2_ = register_mlp(*mlp, "mlp2", width, width);
  ls1_ = mlp->register_parameter("ls1", torch::ones({width}));
  ls2_ = mlp->register_parameter("ls2", torch::ones({width}));
}

at::Tensor PoissonBlockImpl::mlp(std::vector<torch::nn::Linear>& layers, const at::Tensor& x) {
  return layers[1](at::dropout(at::gelu(layers[0](x)), dropout_, is_training()));
}

at::Tensor PoissonBlockImpl::forward(const at::Tensor& x,
                                     const geometry::SurfaceOperators& operators) {
  const geometry::FaceOperators& faces = operators.faces();
  const int64_t count = faces.faces.size(0);
  const at::Tensor stacked = face_gradients(faces, x);  // (B, 2F, C)
  const ComplexPair gradients{stacked.narrow(1, 0, count), stacked.narrow(1, count, count)};
  const ComplexPair turned = grad_mlp_(gradients, vertices_to_faces(x, faces.faces));
  const at::Tensor rhs = face_divergence(faces, at::cat({turned.re, turned.im}, 1));
  const at::Tensor solution = poisson_solve(faces, rhs);
  const at::Tensor u = solution - at_vertices(weighted_means(solution, operators), operators);
  std::vector<at::Tensor> inputs{x, u};
  if (grad_features_) {
    const ComplexPair mixed = grad_features_(turned);
    const at::Tensor products = mixed.re * gradients.re + mixed.im * gradients.im;
    inputs.push_back(at::tanh(faces_to_vertices(products, faces) * grad_scaler_));
  }
  const at::Tensor y = x + ls1_ * mlp(mlp1_, at::cat(inputs, -1));
  return y + ls2_ * mlp(mlp2_, y);
}

PoissonNetImpl::PoissonNetImpl(const PoissonNetOptions& options) : options_(options) {
  options.check();
  proj_in_ = register_module("proj_in", torch::nn::Linear(options.in_channels, options.width));
  head_ = register_module("head", torch::nn::Linear(options.width, options.out_channels));
  const ModulePtr blocks = register_module("blocks", std::make_shared<torch::nn::Module>());
  for (int64_t index = 0; index < options.num_blocks; ++index) {
    blocks_.push_back(blocks->register_module(std::to_string(index), PoissonBlock(options)));
  }
}

at::Tensor PoissonNetImpl::forward_hidden(const at::Tensor& hidden,
                                          const geometry::SurfaceOperators& operators) {
  at::Tensor x = hidden.to(operators.mass.scalar_type());  // what blocks add to stays so: autocast
  for (PoissonBlock& block : blocks_) x = block(x, operators);
  return head_(x);
}

}  // namespace freetalk::nn
