#include "freetalk/nn/poisson.h"

#include <torch/csrc/autograd/custom_function.h>
#include <torch/custom_class.h>
#include <torch/torch.h>

#include "freetalk/core/error.h"
#include "freetalk/nn/sparse.h"

namespace freetalk::nn {
namespace {

using Solvers = std::vector<std::shared_ptr<const geometry::PoissonSolver>>;

struct SolversHolder : torch::CustomClassHolder {
  explicit SolversHolder(Solvers values) : solvers(std::move(values)) {}
  Solvers solvers;
};

/// @param rhs (V, R) float64 on the CPU; each mesh's rows are solved by its own factor.
at::Tensor solve_each(const Solvers& solvers, const at::Tensor& rhs, double regularization) {
  if (solvers.size() == 1) return solvers[0]->solve(rhs, regularization);
  std::vector<at::Tensor> solutions;
  int64_t first = 0;
  for (const auto& solver : solvers) {
    solutions.push_back(
        solver->solve(rhs.narrow(0, first, solver->num_vertices()).contiguous(), regularization));
    first += solver->num_vertices();
  }
  return at::cat(solutions);
}

class PoissonSolve : public torch::autograd::Function<PoissonSolve> {
 public:
  static at::Tensor forward(torch::autograd::AutogradContext* context,
                            const c10::intrusive_ptr<SolversHolder>& holder, const at::Tensor& rhs,
                            double regularization) {
    context->saved_data["solvers"] = c10::IValue::make_capsule(holder);
    context->saved_data["regularization"] = regularization;
    const at::Tensor flat =
        rhs.transpose(0, 1).reshape({rhs.size(1), -1}).to(at::kCPU, at::kDouble);  // (V, B C)
    return solve_each(holder->solvers, flat.contiguous(), regularization)
        .view({rhs.size(1), rhs.size(0), rhs.size(2)})
        .transpose(0, 1)
        .contiguous()
        .to(rhs.options());
  }
  static torch::autograd::tensor_list backward(torch::autograd::AutogradContext* context,
                                               torch::autograd::tensor_list gradients) {
    const auto holder = c10::static_intrusive_pointer_cast<SolversHolder>(
        context->saved_data["solvers"].toCapsule());
    return {
        at::Tensor(),
        PoissonSolve::apply(holder, gradients[0], context->saved_data["regularization"].toDouble()),
        at::Tensor()};
  }
};

}  // namespace

at::Tensor face_gradients(const geometry::FaceOperators& faces, const at::Tensor& x) {
  return sparse_product(faces.gradients, x);
}

at::Tensor face_divergence(const geometry::FaceOperators& faces, const at::Tensor& g) {
  const at::Tensor areas = at::cat({faces.areas, faces.areas}).unsqueeze(1);  // (2F, 1)
  return sparse_product(faces.gradients.transposed(), g * areas);
}

at::Tensor poisson_solve(const geometry::FaceOperators& faces, const at::Tensor& rhs,
                         double regularization) {
  const int64_t vertices = faces.components.size(0);
  FREETALK_CHECK(rhs.dim() == 3 && rhs.size(1) == vertices, "poisson_solve: expected rhs (B, ",
                 vertices, ", C), found ", rhs.sizes());
  return PoissonSolve::apply(c10::make_intrusive<SolversHolder>(faces.solvers), rhs,
                             regularization);
}

at::Tensor vertices_to_faces(const at::Tensor& x, const at::Tensor& faces) {
  const at::Tensor corners = x.index_select(1, faces.reshape({-1}));  // (B, 3F, C)
  return corners.view({x.size(0), faces.size(0), faces.size(1), x.size(2)}).mean(2);
}

}  // namespace freetalk::nn
