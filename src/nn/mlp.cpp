#include "freetalk/nn/mlp.h"

#include <torch/torch.h>

#include "freetalk/core/error.h"

namespace freetalk::nn {

void VertexMlpOptions::check() const {
  FREETALK_CHECK(in_channels > 0 && out_channels > 0 && width > 0 && num_layers >= 0,
                 "VertexMlp: channels and width must be positive, num_layers not negative");
  FREETALK_CHECK(dropout >= 0 && dropout < 1, "VertexMlp: dropout must be in [0, 1), found ",
                 dropout);
}

VertexMlpImpl::VertexMlpImpl(const VertexMlpOptions& options) : options_(options) {
  options.check();
  first_lin_ = register_module("first_lin", torch::nn::Linear(options.in_channels, options.width));
  last_lin_ = register_module("last_lin", torch::nn::Linear(options.width, options.out_channels));
  for (int64_t index = 0; index < options.num_layers; ++index) {
    hidden_.push_back(register_module("hidden_" + std::to_string(index),
                                      torch::nn::Linear(options.width, options.width)));
  }
}

at::Tensor VertexMlpImpl::forward_hidden(const at::Tensor& hidden,
                                         const geometry::SurfaceOperators& /*operators*/) {
  at::Tensor x = hidden;
  for (torch::nn::Linear& layer : hidden_) {
    x = at::dropout(layer(at::relu(x)), options_.dropout, is_training());
  }
  return last_lin_(at::relu(x));
}

}  // namespace freetalk::nn
