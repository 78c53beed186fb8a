#include "freetalk/nn/diffusion_net.h"

#include <torch/torch.h>

#include "core/autocast.h"
#include "freetalk/core/error.h"
#include "freetalk/nn/poisson.h"
#include "freetalk/nn/sparse.h"
#include "nn/implicit_diffusion.h"
#include "nn/surface_means.h"

namespace freetalk::nn {
namespace {

constexpr double kMinDiffusionTime = 1e-8;  // as in the public package, at every forward

/// max(t, least) with the gradient of the public package, which clamps the parameter itself at
/// every forward: that at the clamped value, whole. What is below zero, where the parameter would
/// not have stayed there, takes only gradients that raise it.
class ClampedTime : public torch::autograd::Function<ClampedTime> {
 public:
  static at::Tensor forward(torch::autograd::AutogradContext* context, const at::Tensor& time) {
    context->save_for_backward({time});
    return time.clamp_min(kMinDiffusionTime);
  }
  static torch::autograd::tensor_list backward(torch::autograd::AutogradContext* context,
                                               torch::autograd::tensor_list gradients) {
    const at::Tensor below = context->get_saved_variables()[0] < 0;
    return {at::where(below, gradients[0].clamp_max(0), gradients[0])};
  }
};

/// Phi exp(-lambda t) Phi^T M x on one mesh, never under autocast. @param evals (K,).
at::Tensor spectral_diffusion(const at::Tensor& x, const at::Tensor& time, const at::Tensor& mass,
                              const at::Tensor& evals, const at::Tensor& evecs) {
  const core::NoAutocastScope no_autocast;
  const at::Tensor weighted_basis = (evecs * mass.unsqueeze(1)).t();             // (K, V): Phi^T M
  const at::Tensor spectrum = weighted_basis.matmul(x.to(evecs.scalar_type()));  // (B, K, C)
  const at::Tensor decay = at::exp(-evals.unsqueeze(1) * time.unsqueeze(0));     // (K, C)
  return evecs.matmul(spectrum * decay);
}

}  // namespace

void DiffusionNetOptions::check() const {
  FREETALK_CHECK(in_channels > 0 && out_channels > 0 && width > 0 && num_blocks > 0,
                 "DiffusionNet: channels, width and num_blocks must be positive");
  FREETALK_CHECK(dropout >= 0 && dropout < 1, "DiffusionNet: dropout must be in [0, 1), found ",
                 dropout);
  for (const int64_t hidden : mlp_hidden) {
    FREETALK_CHECK(hidden > 0, "DiffusionNet: mlp_hidden must be positive, found ", hidden);
  }
  FREETALK_CHECK(outputs_at == "vertices" || outputs_at == "edges" || outputs_at == "faces" ||
                     outputs_at == "global_mean",
                 "DiffusionNet: outputs_at must be vertices, edges, faces or global_mean, found ",
                 outputs_at);
  FREETALK_CHECK(diffusion_method == "spectral" || diffusion_method == "implicit_dense",
                 "DiffusionNet: diffusion_method must be spectral or implicit_dense, found ",
                 diffusion_method);
}

LearnedDiffusionImpl::LearnedDiffusionImpl(int64_t channels, bool spectral) : spectral_(spectral) {
  diffusion_time_ = register_parameter("diffusion_time", torch::zeros({channels}));
}

at::Tensor LearnedDiffusionImpl::time() { return ClampedTime::apply(diffusion_time_); }

at::Tensor LearnedDiffusionImpl::forward(const at::Tensor& x,
                                         const geometry::SurfaceOperators& operators) {
  const at::Tensor clamped = time();
  if (!spectral_) return implicit_diffusion(x, clamped, operators);
  if (operators.offsets.empty()) {
    return spectral_diffusion(x, clamped, operators.mass, operators.evals, operators.evecs);
  }
  std::vector<at::Tensor> parts;
  for (int64_t mesh = 0; mesh < operators.num_meshes(); ++mesh) {
    const int64_t first = operators.offsets[static_cast<size_t>(mesh)],
                  count = operators.offsets[static_cast<size_t>(mesh) + 1] - first;
    parts.push_back(spectral_diffusion(
        x.narrow(1, first, count), clamped, operators.mass.narrow(0, first, count),
        operators.evals[mesh], operators.evecs.narrow(0, first, count)));
  }
  return at::cat(parts, 1);
}

GradientFeaturesImpl::GradientFeaturesImpl(int64_t channels, bool rotations) {
  const auto options = torch::nn::LinearOptions(channels, channels).bias(false);
  a_re = register_module(rotations ? "A_re" : "A", torch::nn::Linear(options));
  if (rotations) a_im = register_module("A_im", torch::nn::Linear(options));
}

at::Tensor GradientFeaturesImpl::forward(const at::Tensor& gradients) {
  const int64_t vertices = gradients.size(1) / 2;
  const at::Tensor gx = gradients.narrow(1, 0, vertices),
                   gy = gradients.narrow(1, vertices, vertices);
  const auto re = a_re(gradients).split(vertices, 1);
  if (!a_im) return at::tanh(gx * re[0] + gy * re[1]);
  const auto im = a_im(gradients).split(vertices, 1);
  return at::tanh(gx * (re[0] - im[1]) + gy * (re[1] + im[0]));
}

DiffusionNetBlockImpl::DiffusionNetBlockImpl(const DiffusionNetOptions& options)
    : dropout_(options.dropout) {
  const int64_t channels = options.width;
  diffusion = register_module("diffusion",
                              LearnedDiffusion(channels, options.diffusion_method == "spectral"));
  if (options.with_gradient_features) {
    gradient_features = register_module(
        "gradient_features", GradientFeatures(channels, options.with_gradient_rotations));
  }
  auto layers = register_module("mlp", std::make_shared<torch::nn::Module>());
  std::vector<int64_t> widths = options.mlp_hidden;
  if (widths.empty()) widths = {channels, channels};
  widths.insert(widths.begin(), (options.with_gradient_features ? 3 : 2) * channels);
  widths.push_back(channels);
  for (size_t layer = 0; layer + 1 < widths.size(); ++layer) {
    const std::string number = std::to_string(layer);
    mlp.push_back(layers->register_module(
        "miniMLP_mlp_layer_" + std::string(3 - std::min<size_t>(3, number.size()), '0') + number,
        torch::nn::Linear(widths[layer], widths[layer + 1])));
  }
}

at::Tensor DiffusionNetBlockImpl::forward(const at::Tensor& x,
                                          const geometry::SurfaceOperators& operators) {
  const at::Tensor diffused = diffusion(x, operators);
  std::vector<at::Tensor> inputs{x, diffused};
  if (gradient_features) {
    inputs.push_back(gradient_features(sparse_product(operators.gradients, diffused)));
  }
  at::Tensor y = mlp[0](at::cat(inputs, -1));
  for (size_t layer = 1; layer < mlp.size(); ++layer) {
    y = mlp[layer](at::dropout(at::relu(y), dropout_, is_training()));
  }
  return x + y;
}

DiffusionNetImpl::DiffusionNetImpl(const DiffusionNetOptions& options) : options_(options) {
  options.check();
  first_lin = register_module("first_lin", torch::nn::Linear(options.in_channels, options.width));
  last_lin = register_module("last_lin", torch::nn::Linear(options.width, options.out_channels));
  for (int64_t index = 0; index < options.num_blocks; ++index) {
    blocks_.push_back(
        register_module("block_" + std::to_string(index), DiffusionNetBlock(options)));
  }
}

at::Tensor DiffusionNetImpl::forward_hidden(const at::Tensor& hidden,
                                            const geometry::SurfaceOperators& operators) {
  at::Tensor x = hidden.to(operators.mass.scalar_type());  // what blocks add to stays so: autocast
  for (DiffusionNetBlock& block : blocks_) x = block(x, operators);
  x = last_lin(x);
  if (options_.outputs_at == "edges") {
    return vertices_to_faces(x, geometry::unique_edges(operators.faces().faces).to(x.device()));
  }
  if (options_.outputs_at == "faces") return vertices_to_faces(x, operators.faces().faces);
  if (options_.outputs_at == "global_mean") return weighted_means(x, operators);
  return x;
}

}  // namespace freetalk::nn
