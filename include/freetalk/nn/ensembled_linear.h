// Linear layers of an ensemble whose first members come in pairs that share their weights, applied
// to rows that were gathered for each member: one matrix product a network.
#pragma once

#include <torch/nn/module.h>
#include <torch/nn/pimpl.h>

#include <vector>

namespace freetalk::nn {

/// y_r = x_r W_g^T for the rows r in first[g] .. first[g + 1] - 1 of every group g. Twice
/// differentiable in both tensors.
/// @param x (R, in), rows of a group side by side. @param weight (G, out, in).
/// @param first G + 1 ascending rows, from 0 to R.
/// @returns (R, out) of x's dtype.
at::Tensor grouped_product(const at::Tensor& x, const at::Tensor& weight,
                           const std::vector<int64_t>& first);

/// An ensemble of M linear layers [NPHM, Giebenhain et al. 2023]. Members 2i and 2i + 1, i <
/// num_pairs, share the weights of network i; every other member has a network of its own, so that
/// there are M - num_pairs networks.
class EnsembledLinearImpl : public torch::nn::Module {
 public:
  EnsembledLinearImpl(int64_t num_members, int64_t num_pairs, int64_t in_channels,
                      int64_t out_channels);
  /// @param x (M, N, in). @returns (M, N, out).
  at::Tensor forward(const at::Tensor& x);

  at::Tensor weight;  // (M - num_pairs, out, in)
  at::Tensor bias;    // (M - num_pairs, out)

 private:
  int64_t num_members_, num_pairs_;
};
TORCH_MODULE(EnsembledLinear);

/// The network of every member, (M,) int64.
std::vector<int64_t> networks_of_members(int64_t num_members, int64_t num_pairs);

}  // namespace freetalk::nn
