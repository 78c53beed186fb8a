// Takes from fields on a surface what is finer than a length that may differ from place to place.
//
// The result u of a field f minimises the integral of |u - f|^2 + l^4 |Laplacian(u)|^2,
//   u = (M + L diag(l^4 / m) L)^-1 M f
// with the cotangent Laplacian L and the lumped mass M = diag(m). A wave of length w keeps
// 1 / (1 + (2 pi l / w)^4) of its height: the low-pass of Butterworth's second order, on a surface.
// Linear fields on flat parts stay as they are, and nothing crosses a gap such as that between
// lips.
#pragma once

#include <ATen/core/Tensor.h>
#include <c10/util/intrusive_ptr.h>
#include <Eigen/Core>

namespace freetalk::geometry {

struct FactoredLowPass;

/// Factored once a surface, for any number of fields; immutable, copies share the factor.
class SurfaceLowPass {
 public:
  /// The surface is welded as for surface_operators; vertices that become one get one value.
  /// @param vertices (V, 3). @param faces (F, 3). @param lengths (V,) l, unit of the vertices; 0
  /// keeps a field as it is there. @throws std::invalid_argument for a length below 0 or not
  /// finite.
  SurfaceLowPass(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                 const Eigen::VectorXd& lengths);
  ~SurfaceLowPass();
  SurfaceLowPass(const SurfaceLowPass&);
  SurfaceLowPass& operator=(const SurfaceLowPass&);

  /// @param fields (T, V, C) floating. @returns (T, V, C), computed on the host in double;
  /// differentiable. @throws std::invalid_argument for another number of vertices.
  at::Tensor apply(const at::Tensor& fields) const;

 private:
  c10::intrusive_ptr<FactoredLowPass> factored_;
};

}  // namespace freetalk::geometry
