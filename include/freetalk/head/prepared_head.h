// A head made ready for one identity on a CPU: its code is folded into biases, weights are packed
// for the kernels, and only the local networks that matter at a point are evaluated. Equal to
// ParametricHead in eval mode up to rounding.
#pragma once

#include <ATen/core/Tensor.h>

#include <memory>
#include <string>
#include <utility>

#include "freetalk/head/parametric_head.h"

namespace freetalk::head {

struct PreparedOptions {
  /// Hidden channels: "float32", or "bfloat16": twice as fast where the processor multiplies them,
  /// off by some hundredths of a millimetre; float32 elsewhere.
  std::string precision = "float32";
  template <class V>
  void fields(V& v) {
    v("precision", precision);
  }
  void check() const;
};

/// Immutable: safe to use from several threads. Points are in head units.
class PreparedHead {
 public:
  /// @param head on the CPU; its weights must not change meanwhile. @param z_id (identity_dim,).
  PreparedHead(const ParametricHead& head, const at::Tensor& z_id,
               const PreparedOptions& options = {});

  /// @param points (N, 3) canonical. @param z_exp (expression_dim,) where the identity field sees
  /// it. @param hyper (N, hyper_dim) likewise. @returns (N,) float32.
  at::Tensor canonical_sdf(const at::Tensor& points, const at::Tensor& z_exp = {},
                           const at::Tensor& hyper = {}) const;
  /// The same before it fades to 0 away from the anchors: a distance everywhere, of the same sign.
  at::Tensor unfaded_sdf(const at::Tensor& points, const at::Tensor& z_exp = {},
                         const at::Tensor& hyper = {}) const;
  /// @param points (N, 3) posed. @param z_exp (expression_dim,). @returns (N,) float32.
  at::Tensor sdf(const at::Tensor& points, const at::Tensor& z_exp) const;
  /// @returns points (N, 3) and, where the identity field sees it, hyper (N, hyper_dim).
  CanonicalPoints to_canonical(const at::Tensor& points, const at::Tensor& z_exp) const;
  /// @returns (N, 3).
  at::Tensor to_posed(const at::Tensor& points, const at::Tensor& z_exp) const;
  /// Offsets (N, 3) of the backward network at posed points and their derivatives (N, 3, 3); in the
  /// head's own float32, unpacked.
  std::pair<at::Tensor, at::Tensor> backward_with_jacobian(const at::Tensor& points,
                                                           const at::Tensor& z_exp) const;

  const HeadOptions& options() const;
  /// The head that this was made of.
  const ParametricHead& head() const;
  const at::Tensor& z_id() const;     // (identity_dim,)
  const at::Tensor& anchors() const;  // (num_anchors, 3)

 private:
  struct State;
  std::shared_ptr<const State> state_;
};

}  // namespace freetalk::head
