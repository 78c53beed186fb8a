// The identity field of a neural parametric head [NPHM, Giebenhain et al. 2023]: a signed distance
// in canonical space, blended from local networks around anchors that the identity's code places.
//
//   s(x) = sum_k w_k s_k(x - a_k, z_glob, z_k) / (sum_k w_k + eps),
//   w_k = exp(-(|x - a_k| + 1e-5)^2 / sigma^2),  a = mean + MLP(z_glob)
//
// The last member, the background, has no anchor: it sees x itself, with w = e^-20. Anchors 2i and
// 2i + 1 share a network; the odd one sees x mirrored. Only members whose normalised weight exceeds
// min_weight are evaluated, and take over the weight of the others.
//
// Names equal the public NPHM code's: ensembled_deep_sdf.lin0-L, mlp_pos.0|2|4.
#pragma once

#include <torch/nn/modules/container/sequential.h>
#include <torch/nn/pimpl.h>

#include <string>

#include "freetalk/nn/field_mlp.h"

namespace freetalk::head {

struct IdentityOptions {
  int64_t global_dim = 64;       // channels of z_glob
  int64_t local_dim = 32;        // channels of each z_k
  int64_t num_anchors = 39;      // K - 1; with the background there are K members
  int64_t num_pairs = 16;        // mirrored pairs, which come first
  int64_t hidden = 200;          // of the local networks
  int64_t num_layers = 4;        // hidden layers of the local networks
  int64_t anchor_hidden = 256;   // of the anchors' MLP
  int64_t hyper_dim = 0;         // further coordinates that a deformation adds to x
  int64_t expression_dim = 0;    // channels of z_exp where the field sees it, else 0
  double kernel_width = 0.1;     // sigma, head units
  double normalizer_eps = 1e-6;  // eps; from where it exceeds the weights the field fades to 0
  double min_weight = 1e-3;      // in [0, 1); 0 evaluates every member everywhere
  /// The background in eval mode: "learned", or "outside": 1, as NPHM evaluates it.
  std::string background = "learned";
  void check() const;
  int64_t num_members() const { return num_anchors + 1; }
  /// Channels of z_id = [z_glob | z_1 | ... | z_K].
  int64_t code_dim() const { return global_dim + num_members() * local_dim; }
  nn::FieldMlpOptions local_mlp() const;
};

/// Where a field is asked, and under which codes.
struct FieldQuery {
  at::Tensor points;      // (B, N, 3) head units, canonical
  at::Tensor identity;    // (B, code_dim)
  at::Tensor hyper;       // (B, N, hyper_dim); undefined: zeros
  at::Tensor expression;  // (B, expression_dim) where the field sees it
};

class IdentityFieldImpl : public torch::nn::Module {
 public:
  explicit IdentityFieldImpl(const IdentityOptions& options);
  /// @returns (B, N) signed distances in head units, negative inside.
  at::Tensor forward(const FieldQuery& query);
  /// @param identity (B, code_dim). @returns (B, K - 1, 3) head units.
  at::Tensor predict_anchors(const at::Tensor& identity);
  /// [z_glob | z_k (| z_exp)] of every member: (K, B, C), what its network is conditioned on.
  at::Tensor member_codes(const at::Tensor& identity, const at::Tensor& expression) const;
  /// z_k of every member: (B, K, local_dim). @param identity (B, code_dim).
  at::Tensor local_codes(const at::Tensor& identity) const;

  at::Tensor anchors;  // (K - 1, 3) mean anchors, head units; a buffer

  const IdentityOptions& options() const { return options_; }
  const nn::EnsembledFieldMlp& local_networks() const { return ensembled_deep_sdf_; }

 private:
  void check_query(const FieldQuery& query) const;
  /// (K, B, N) weights before they are normalised.
  at::Tensor weights(const at::Tensor& points, const at::Tensor& anchors) const;

  IdentityOptions options_;
  nn::EnsembledFieldMlp ensembled_deep_sdf_{nullptr};
  torch::nn::Sequential mlp_pos_{nullptr};
};
TORCH_MODULE(IdentityField);

}  // namespace freetalk::head
