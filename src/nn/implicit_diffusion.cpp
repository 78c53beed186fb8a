#include "nn/implicit_diffusion.h"

#include <torch/custom_class.h>
#include <torch/torch.h>

#include <Eigen/Core>

#include "core/parallel.h"
#include "freetalk/core/error.h"
#include "freetalk/geometry/sparse_cholesky.h"

namespace freetalk::nn {
namespace {

using geometry::SparseMatrix;
using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Laplacian (all meshes of a batch on its diagonal) and mass.
struct System : torch::CustomClassHolder {
  SparseMatrix laplacian;
  Eigen::VectorXd mass;

  explicit System(const geometry::SurfaceOperators& operators) {
    const int64_t vertices = operators.num_vertices();
    std::vector<Eigen::Triplet<double>> entries;
    int64_t first = 0;
    for (const auto& solver : operators.faces().solvers) {
      const SparseMatrix& block = solver->laplacian();
      for (int column = 0; column < block.outerSize(); ++column) {
        for (SparseMatrix::InnerIterator entry(block, column); entry; ++entry) {
          entries.emplace_back(first + entry.row(), first + entry.col(), entry.value());
        }
      }
      first += block.rows();
    }
    for (int64_t v = 0; v < vertices; ++v) entries.emplace_back(v, v, 0.0);
    laplacian.resize(vertices, vertices);
    laplacian.setFromTriplets(entries.begin(), entries.end());
    const at::Tensor values = operators.mass.to(at::kCPU, at::kDouble).contiguous();
    mass = Eigen::Map<const Eigen::VectorXd>(values.const_data_ptr<double>(), vertices);
  }

  /// (M + t_c L)^-1 applied to each channel. @param x (C, V, B) float64, contiguous.
  at::Tensor solve(const at::Tensor& x, const at::Tensor& time) const {
    at::Tensor result = x.clone(at::MemoryFormat::Contiguous);
    const at::Tensor times = time.contiguous();
    const int64_t size = x.size(1) * x.size(2);
    core::parallel_for(0, x.size(0), 1, [&](int64_t begin, int64_t end) {
      std::unique_ptr<geometry::SparseCholesky> factor;
      for (int64_t channel = begin; channel < end; ++channel) {
        SparseMatrix matrix = times.const_data_ptr<double>()[channel] * laplacian;
        matrix.diagonal() += mass;
        if (factor) {
          factor->refactor(matrix);
        } else {
          factor = std::make_unique<geometry::SparseCholesky>(matrix);
        }
        factor->solve(result.data_ptr<double>() + channel * size, x.size(2));
      }
    });
    return result;
  }

  /// L applied to each channel. @param x (C, V, B) float64, contiguous.
  at::Tensor stiffness(const at::Tensor& x) const {
    at::Tensor result = at::empty_like(x);
    for (int64_t channel = 0; channel < x.size(0); ++channel) {
      const Eigen::Map<const RowMatrix> in(x[channel].const_data_ptr<double>(), x.size(1),
                                           x.size(2));
      Eigen::Map<RowMatrix>(result[channel].data_ptr<double>(), x.size(1), x.size(2)) =
          laplacian * in;
    }
    return result;
  }

  at::Tensor mass_column() const {
    return at::from_blob(const_cast<double*>(mass.data()), {1, mass.size(), 1}, at::kDouble);
  }
};

at::Tensor channels_first(const at::Tensor& x) {  // (B, V, C) -> (C, V, B)
  return x.permute({2, 1, 0}).to(at::kCPU, at::kDouble).contiguous();
}

class ImplicitDiffusion : public torch::autograd::Function<ImplicitDiffusion> {
 public:
  static at::Tensor forward(torch::autograd::AutogradContext* context,
                            const c10::intrusive_ptr<System>& system, const at::Tensor& x,
                            const at::Tensor& time) {
    const at::Tensor times = time.to(at::kCPU, at::kDouble);
    const at::Tensor u = system->solve(channels_first(x) * system->mass_column(), times);
    context->saved_data["system"] = c10::IValue::make_capsule(system);
    context->save_for_backward({u, times});
    context->saved_data["like_time"] = time.new_empty({0});
    return u.permute({2, 1, 0}).contiguous().to(x.options());
  }
  static torch::autograd::tensor_list backward(torch::autograd::AutogradContext* context,
                                               torch::autograd::tensor_list gradients) {
    const auto saved = context->get_saved_variables();
    const auto system =
        c10::static_intrusive_pointer_cast<System>(context->saved_data["system"].toCapsule());
    // (M + t L) du = M dx - dt L u, and the matrix is symmetric.
    const at::Tensor adjoint = system->solve(channels_first(gradients[0]), saved[1]);
    const at::Tensor of_x = (adjoint * system->mass_column()).permute({2, 1, 0}).contiguous();
    const at::Tensor of_time = -(adjoint * system->stiffness(saved[0])).sum({1, 2});
    return {at::Tensor(), of_x.to(gradients[0].options()),
            of_time.to(context->saved_data["like_time"].toTensor().options())};
  }
};

}  // namespace

at::Tensor implicit_diffusion(const at::Tensor& x, const at::Tensor& time,
                              const geometry::SurfaceOperators& operators) {
  FREETALK_CHECK(x.dim() == 3 && x.size(1) == operators.num_vertices() && time.dim() == 1 &&
                     time.size(0) == x.size(2),
                 "implicit_diffusion: expected x (B, ", operators.num_vertices(),
                 ", C) and time (C,), found ", x.sizes(), " and ", time.sizes());
  return ImplicitDiffusion::apply(c10::make_intrusive<System>(operators),
                                  x.to(operators.mass.scalar_type()), time);
}

}  // namespace freetalk::nn
