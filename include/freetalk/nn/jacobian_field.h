// Neural Jacobian Fields [Aigerman et al. 2022]: a network at every face predicts the Jacobian of a
// map; the map is the one whose gradients come closest, found by a Poisson solve.
//
//   J_f = MLP(mean of the corners' features)            (3, 3), restricted to the face's plane
//   u = argmin sum_f A_f |grad u_f - J_f|^2,  centred   L u = G^T A J
//
// Jacobians fix a map up to a translation of each connected part. `translation` adds that: the
// area-weighted mean over the part of three more outputs of the network; without, every part stays
// centred where it was, as in the paper.
#pragma once

#include <torch/nn/pimpl.h>

#include <vector>

#include "freetalk/nn/surface_net.h"

namespace freetalk::nn {

struct JacobianFieldOptions {
  int64_t in_channels = 6;
  int64_t width = 128;
  int64_t num_layers = 3;  // hidden layers between the first and the last linear one
  double dropout = 0.0;
  bool translation = false;  // predict the translation of each connected part; the paper: no
  template <class V>
  void fields(V& v) {
    v("in_channels", in_channels);
    v("width", width);
    v("num_layers", num_layers);
    v("dropout", dropout);
    v("translation", translation);
  }
  void check() const;
};

/// Values at the vertices to displacements of the vertices (B, V, 3).
class JacobianFieldImpl : public SurfaceNetImpl {
 public:
  explicit JacobianFieldImpl(const JacobianFieldOptions& options);
  at::Tensor forward_hidden(const at::Tensor& hidden,
                            const geometry::SurfaceOperators& operators) override;
  torch::nn::Linear& first_layer() override { return first_lin_; }
  torch::nn::Linear& last_layer() override { return last_lin_; }
  const JacobianFieldOptions& options() const { return options_; }

 private:
  JacobianFieldOptions options_;
  torch::nn::Linear first_lin_{nullptr}, last_lin_{nullptr};
  std::vector<torch::nn::Linear> hidden_;
};
TORCH_MODULE(JacobianField);

/// The map whose gradients come closest to Jacobians, each connected part centred.
/// @param faces with P connected parts. @param jacobians (B, F, 3, 3): row c the gradient of
///   coordinate c; what is normal to the face counts for nothing. @returns (B, V, 3).
at::Tensor integrate_jacobians(const geometry::FaceOperators& faces, const at::Tensor& jacobians);

}  // namespace freetalk::nn
