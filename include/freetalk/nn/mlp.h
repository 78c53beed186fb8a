// A multi-layer perceptron at every vertex by itself, the "shared MLP" of point networks.
#pragma once

#include <torch/nn/pimpl.h>

#include <vector>

#include "freetalk/nn/surface_net.h"

namespace freetalk::nn {

struct VertexMlpOptions {
  int64_t in_channels = 6;
  int64_t out_channels = 128;
  int64_t width = 128;
  int64_t num_layers = 4;  // hidden layers between the first and the last linear one
  double dropout = 0.0;    // after each hidden layer's ReLU
  template <class V>
  void fields(V& v) {
    v("in_channels", in_channels);
    v("out_channels", out_channels);
    v("width", width);
    v("num_layers", num_layers);
    v("dropout", dropout);
  }
  void check() const;
};

/// last_lin(relu(hidden_n(... relu(first_lin(x))))): no vertex sees another.
class VertexMlpImpl : public SurfaceNetImpl {
 public:
  explicit VertexMlpImpl(const VertexMlpOptions& options);
  at::Tensor forward_hidden(const at::Tensor& hidden,
                            const geometry::SurfaceOperators& operators) override;
  torch::nn::Linear& first_layer() override { return first_lin_; }
  torch::nn::Linear& last_layer() override { return last_lin_; }
  const VertexMlpOptions& options() const { return options_; }

 private:
  VertexMlpOptions options_;
  torch::nn::Linear first_lin_{nullptr}, last_lin_{nullptr};
  std::vector<torch::nn::Linear> hidden_;
};
TORCH_MODULE(VertexMlp);

}  // namespace freetalk::nn
