// The expression network of a neural parametric head: one coordinate network that moves points
// between the posed and the canonical face [NPHM; FaceTalk 3].
//
//   delta(x) = MLP(x, C [z_id | a] + c, z_exp)
//
// A backward field moves posed points to canonical space, as FaceTalk's does; a forward one
// canonical points to the posed face, as the published NPHM's. Names equal the public NPHM code's:
// compressor.0, defDeepSDF.lin0-L.
#pragma once

#include <torch/nn/modules/container/sequential.h>
#include <torch/nn/pimpl.h>

#include "freetalk/nn/field_mlp.h"

namespace freetalk::head {

struct DeformationOptions {
  int64_t identity_dim = 1461;     // channels of [z_id | a]
  int64_t identity_code_dim = 32;  // channels that they are compressed to
  int64_t expression_dim = 200;    // channels of z_exp
  int64_t hidden = 512;            //
  int64_t num_layers = 6;          // hidden layers
  int64_t hyper_dim = 0;           // further coordinates, beside the offset
  double identity_noise = 0.0;     // of the compressed code in training; NPHM: 0.005
  void check() const;
  nn::FieldMlpOptions mlp() const;
};

/// What a deformation depends on besides the point.
struct DeformationCodes {
  at::Tensor identity;    // (B, D) z_id
  at::Tensor anchors;     // (B, K - 1, 3) head units
  at::Tensor expression;  // (B, expression_dim) z_exp
};

class DeformationFieldImpl : public torch::nn::Module {
 public:
  explicit DeformationFieldImpl(const DeformationOptions& options);
  /// @param points (B, N, 3) head units.
  /// @returns (B, N, 3 + hyper_dim): offsets, then further coordinates.
  at::Tensor forward(const at::Tensor& points, const DeformationCodes& codes);
  /// C [z_id | a] + c. @returns (B, identity_code_dim).
  at::Tensor compress(const at::Tensor& identity, const at::Tensor& anchors);
  /// [compressed | z_exp], what the network is conditioned on: (B, code_dim).
  at::Tensor code(const DeformationCodes& codes);

  const DeformationOptions& options() const { return options_; }
  const nn::FieldMlp& network() const { return def_deep_sdf_; }

 private:
  DeformationOptions options_;
  torch::nn::Sequential compressor_{nullptr};
  nn::FieldMlp def_deep_sdf_{nullptr};
};
TORCH_MODULE(DeformationField);

}  // namespace freetalk::head
