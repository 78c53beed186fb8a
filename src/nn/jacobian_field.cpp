#include "freetalk/nn/jacobian_field.h"

#include <torch/torch.h>

#include "core/autocast.h"
#include "freetalk/core/error.h"
#include "freetalk/nn/poisson.h"

namespace freetalk::nn {
namespace {

// Far below the smallest eigenvalue of L (about 12 / V): the solve is the unregularised one.
constexpr double kRegularization = 1e-9;

/// Sums over the rows of each part. @param x (B, N, C). @param part (N,). @returns (B, parts, C).
at::Tensor sum_of_parts(const at::Tensor& x, const at::Tensor& part, int64_t parts) {
  return at::zeros({x.size(0), parts, x.size(2)}, x.options()).index_add(1, part, x);
}

/// Weighted means over the parts. @param weights (N,); parts without weight get zero.
at::Tensor mean_of_parts(const at::Tensor& x, const at::Tensor& weights, const at::Tensor& part,
                         int64_t parts) {
  const at::Tensor w = weights.to(x.scalar_type()).view({1, -1, 1});
  const at::Tensor total = sum_of_parts(w, part, parts);
  return sum_of_parts(x * w, part, parts) / total.masked_fill(total == 0, 1);
}

}  // namespace

void JacobianFieldOptions::check() const {
  FREETALK_CHECK(in_channels > 0 && width > 0 && num_layers >= 0,
                 "JacobianField: channels and width must be positive, num_layers not negative");
  FREETALK_CHECK(dropout >= 0 && dropout < 1, "JacobianField: dropout must be in [0, 1), found ",
                 dropout);
}

JacobianFieldImpl::JacobianFieldImpl(const JacobianFieldOptions& options) : options_(options) {
  options.check();
  first_lin_ = register_module("first_lin", torch::nn::Linear(options.in_channels, options.width));
  last_lin_ =
      register_module("last_lin", torch::nn::Linear(options.width, options.translation ? 12 : 9));
  for (int64_t index = 0; index < options.num_layers; ++index) {
    hidden_.push_back(register_module("hidden_" + std::to_string(index),
                                      torch::nn::Linear(options.width, options.width)));
  }
}

at::Tensor JacobianFieldImpl::forward_hidden(const at::Tensor& hidden,
                                             const geometry::SurfaceOperators& operators) {
  const geometry::FaceOperators& faces = operators.faces();
  at::Tensor x = vertices_to_faces(hidden, faces.faces);  // (B, F, width): commutes with first_lin
  for (torch::nn::Linear& layer : hidden_) {
    x = at::dropout(layer(at::relu(x)), options_.dropout, is_training());
  }
  const at::Tensor outputs =
      last_lin_(at::relu(x)).to(faces.areas.scalar_type());  // (B, F, 9 | 12)
  const at::Tensor map = integrate_jacobians(
      faces, outputs.narrow(2, 0, 9).reshape({outputs.size(0), outputs.size(1), 3, 3}));
  if (!options_.translation) return map;
  const at::Tensor part_of_face = faces.components.index_select(0, faces.faces.select(1, 0));
  const at::Tensor shift =
      mean_of_parts(outputs.narrow(2, 9, 3), faces.areas, part_of_face, faces.num_components);
  return map + shift.index_select(1, faces.components);
}

at::Tensor integrate_jacobians(const geometry::FaceOperators& faces, const at::Tensor& jacobians) {
  const int64_t count = faces.faces.size(0);
  FREETALK_CHECK(jacobians.dim() == 4 && jacobians.size(1) == count && jacobians.size(2) == 3 &&
                     jacobians.size(3) == 3,
                 "integrate_jacobians: expected (B, ", count, ", 3, 3), found ", jacobians.sizes());
  const core::NoAutocastScope no_autocast;
  const at::Tensor tangents =
      faces.frames.narrow(1, 0, 2).to(jacobians.scalar_type());  // (F, 2, 3)
  const at::Tensor restricted =
      at::einsum("bfcd,fed->befc", {jacobians, tangents});  // (B, 2, F, 3)
  const at::Tensor rhs = face_divergence(faces, restricted.reshape({jacobians.size(0), -1, 3}));
  const at::Tensor map = poisson_solve(faces, rhs, kRegularization);
  const at::Tensor mean =
      mean_of_parts(map, at::ones_like(faces.components), faces.components, faces.num_components);
  return map - mean.index_select(1, faces.components);
}

}  // namespace freetalk::nn
