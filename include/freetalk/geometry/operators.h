// Everything a DiffusionNet needs of a mesh: mass, eigenbasis, gradients, normals; computed once,
// cached on disk.
#pragma once

#include <ATen/core/Tensor.h>
#include <Eigen/Core>

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "freetalk/geometry/poisson.h"
#include "freetalk/geometry/sparse_operator.h"

namespace freetalk::core {
template <class T>
class Deferred;
}

namespace freetalk::geometry {

struct OperatorOptions {
  int64_t k_eig = 128;  // K, number of eigenpairs; 1 .. V
  // "cotan": as the public diffusion_net; "robust": the tufted Laplacian (see robust_laplacian.h),
  // for torn and non-manifold meshes, triangle soups and point clouds.
  std::string laplacian = "cotan";
  // "relative": guards relative to each element's size, so that operators follow a uniform scale
  // exactly; "absolute": the public diffusion_net package's constants (1e-10, 1e-5), which suit
  // meshes of unit size only.
  std::string regularization = "relative";
  // "none", "coincident" or "fragments": what is joined for the operators alone (see weld.h), so
  // that texture seams, tears and loose faces do not use eigenpairs up.
  std::string weld = "fragments";
  double residual_tolerance = 1e-6;  // largest eigen-residual accepted (see eigenbasis.h)

  template <class Visitor>
  void fields(Visitor& visit) {
    visit("k_eig", k_eig);
    visit("laplacian", laplacian);
    visit("regularization", regularization);
    visit("weld", weld);
    visit("residual_tolerance", residual_tolerance);
  }
  void check() const;
};

/// Operators of a surface; float64 on the CPU until `to` is called.
struct SurfaceOperators {
  at::Tensor mass;           ///< (V,) length^2
  at::Tensor evals;          ///< (K,) 1 / length^2
  at::Tensor evecs;          ///< (V, K) 1 / length, mass-orthonormal
  SparseOperator gradients;  ///< (2V, V) 1 / length: X components, then Y components
  at::Tensor normals;        ///< (V, 3)
  at::Tensor frames;         ///< (V, 3, 3) rows X, Y, normal
  at::Tensor residuals;      ///< (K,) relative eigen-residuals
  /// What lives on the faces, computed when first asked for; null for point clouds. See faces().
  std::shared_ptr<const core::Deferred<FaceOperators>> on_faces;
  /// {0, V_0, V_0 + V_1, ...} of meshes laid one after the other (see concatenate); empty for one.
  /// There evals is (meshes, K).
  std::vector<int64_t> offsets;

  int64_t num_vertices() const { return mass.size(0); }
  int64_t k_eig() const { return evals.size(-1); }
  int64_t num_meshes() const {
    return offsets.empty() ? 1 : static_cast<int64_t>(offsets.size()) - 1;
  }
  /// Faces, their gradients and the Poisson solver.
  /// @throws std::invalid_argument for operators without faces.
  const FaceOperators& faces() const;

  /// The operators of the same surface scaled uniformly by `factor` > 0.
  SurfaceOperators scaled(double factor) const;
  /// The operators of the same surface turned by a rotation (3, 3).
  SurfaceOperators turned(const at::Tensor& rotation) const;
  /// A copy on `device` with `dtype` (float32 or float64).
  SurfaceOperators to(at::ScalarType dtype, const c10::Device& device = c10::kCPU) const;
};

/// Several meshes of any sizes laid one after the other: a block-diagonal batch. Networks take
/// their values as (B, V_0 + V_1 + ..., C).
/// @param parts of one mesh each, with the same number of eigenpairs, dtype and device.
/// @throws std::invalid_argument for none, or parts that differ in eigenpairs.
SurfaceOperators concatenate(const std::vector<SurfaceOperators>& parts);

/// @param vertices (V, 3) any unit. @param faces (F, 3); (0, 3) for a point cloud, with "robust".
/// @param name names the mesh in messages.
/// @param progress called with the finished share of the eigenbasis in (0, 1]; may throw to stop.
/// @throws std::invalid_argument for bad options, indices out of range, NaN, more eigenpairs than
///   vertices, a surface without area; std::runtime_error if the eigensolver fails.
SurfaceOperators surface_operators(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                   const OperatorOptions& options = {},
                                   const std::string& name = "mesh",
                                   const std::function<void(double)>& progress = {});

/// $FREETALK_CACHE, or $XDG_CACHE_HOME/freetalk, or ~/.cache/freetalk.
std::filesystem::path default_cache_dir();

/// As surface_operators, kept in `cache_dir`/operators under a key of content, options and version.
/// Several processes may share the folder: files are written atomically and a damaged one is
/// computed again. Beyond `max_bytes` the entries unused for longest go, and one larger than that
/// is not kept. An unwritable folder costs the cache, not the result.
/// @param cache_dir empty for default_cache_dir().
SurfaceOperators cached_surface_operators(const Eigen::MatrixXd& vertices,
                                          const Eigen::MatrixXi& faces,
                                          const OperatorOptions& options = {},
                                          const std::filesystem::path& cache_dir = {},
                                          const std::string& name = "mesh",
                                          int64_t max_bytes = int64_t{4} << 30,
                                          const std::function<void(double)>& progress = {});

}  // namespace freetalk::geometry
