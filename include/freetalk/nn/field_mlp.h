// Coordinate networks of neural parametric heads [DeepSDF, Park et al. 2019; NPHM, Giebenhain et
// al. 2023]:
//
//   x_0 = [p | z],  x_{l+1} = softplus_beta(W_l x_l + b_l),  x_s = [x_s | p | z] / sqrt(2) at s = L
//   / 2,  y = W_L x_L + b_L.
//
// A code belongs to many points, so its columns are folded into a bias once. Coordinates are
// multiplied in float32 also under autocast, and so is the last layer: eight bits of a coordinate
// are millimetres.
#pragma once

#include <torch/nn/modules/linear.h>
#include <torch/nn/pimpl.h>

#include <utility>
#include <vector>

#include "freetalk/nn/ensembled_linear.h"

namespace freetalk::nn {

struct FieldMlpOptions {
  int64_t point_dim = 3;  // channels of p
  int64_t code_dim = 0;   // channels of z
  int64_t hidden = 512;
  int64_t num_layers = 6;  // L, hidden layers; the input joins again before layer L / 2
  int64_t out_dim = 1;
  double beta = 100.0;  // sharpness of softplus(x) = log(1 + exp(beta x)) / beta
  void check() const;
  int64_t skip_layer() const { return num_layers / 2; }
  int64_t input_dim() const { return point_dim + code_dim; }
  /// Inputs and outputs of layer `layer` in 0 .. L.
  std::pair<int64_t, int64_t> layer_dims(int64_t layer) const;
};

/// One network over batches of points; parameters lin0.weight, lin0.bias, ..., linL.bias.
class FieldMlpImpl : public torch::nn::Module {
 public:
  explicit FieldMlpImpl(const FieldMlpOptions& options);
  /// @param points (B, N, point_dim). @param codes (B, code_dim). @returns (B, N, out_dim).
  at::Tensor forward(const at::Tensor& points, const at::Tensor& codes);
  /// The values and their derivatives in the first `directions` coordinates.
  /// @returns (B, N, out_dim) and (B, N, out_dim, directions).
  std::pair<at::Tensor, at::Tensor> with_jacobian(const at::Tensor& points, const at::Tensor& codes,
                                                  int64_t directions = 3);

  const FieldMlpOptions& options() const { return options_; }
  const std::vector<torch::nn::Linear>& layers() const { return layers_; }

 private:
  void check_inputs(const at::Tensor& points, const at::Tensor& codes) const;
  /// What a layer adds besides its product with the hidden channels: columns of p and z, bias.
  at::Tensor from_inputs(int64_t layer, const at::Tensor& points, const at::Tensor& codes);

  FieldMlpOptions options_;
  std::vector<torch::nn::Linear> layers_;
};
TORCH_MODULE(FieldMlp);

/// Rows of points for the members of an ensemble, sorted by member, then by code.
struct EnsembleRows {
  at::Tensor points;           // (R, point_dim)
  std::vector<int64_t> first;  // M B + 1: rows first[m B + b] .. first[m B + b + 1] - 1 are of
                               // member m under its b-th code
};

/// An ensemble of networks; parameters lin0.weight (networks, out, in), ... of EnsembledLinear.
class EnsembledFieldMlpImpl : public torch::nn::Module {
 public:
  EnsembledFieldMlpImpl(int64_t num_members, int64_t num_pairs, const FieldMlpOptions& options);
  /// @param codes (M, B, code_dim). @returns (R, out_dim).
  at::Tensor forward(const EnsembleRows& rows, const at::Tensor& codes);

  const FieldMlpOptions& options() const { return options_; }
  const std::vector<EnsembledLinear>& layers() const { return layers_; }

 private:
  FieldMlpOptions options_;
  int64_t num_members_, num_pairs_;
  std::vector<EnsembledLinear> layers_;
};
TORCH_MODULE(EnsembledFieldMlp);

}  // namespace freetalk::nn
