#include "freetalk/nn/field_mlp.h"

#include <ATen/autocast_mode.h>
#include <torch/torch.h>

#include <cmath>

#include "core/autocast.h"
#include "freetalk/core/error.h"

namespace freetalk::nn {
namespace {

/// torch::nn::Softplus gives x itself beyond this.
constexpr double kSoftplusThreshold = 20.0;

at::Tensor softplus(const at::Tensor& x, double beta) {
  return at::softplus(x, beta, kSoftplusThreshold);
}

/// The type that products of hidden channels run in: autocast's where it is on.
at::ScalarType product_dtype(const at::Tensor& x) {
  const auto device = x.device().type();
  return at::autocast::is_autocast_available(device) && at::autocast::is_autocast_enabled(device)
             ? at::autocast::get_autocast_dtype(device)
             : x.scalar_type();
}

/// Columns of a layer's weight: those of hidden channels, of points and of codes.
struct Columns {
  at::Tensor hidden, points, codes;
};

/// @param weight (..., out, in) of layer `layer`.
Columns columns_of(const FieldMlpOptions& options, int64_t layer, const at::Tensor& weight) {
  const bool first = layer == 0, skip = layer > 0 && layer == options.skip_layer();
  if (!first && !skip) return {weight, {}, {}};
  const at::Tensor scaled = skip ? weight * std::sqrt(0.5) : weight;
  const int64_t hidden = weight.size(-1) - options.input_dim();
  return {hidden > 0 ? scaled.narrow(-1, 0, hidden) : at::Tensor(),
          scaled.narrow(-1, hidden, options.point_dim),
          scaled.narrow(-1, hidden + options.point_dim, options.code_dim)};
}

}  // namespace

void FieldMlpOptions::check() const {
  FREETALK_CHECK(point_dim > 0 && code_dim >= 0 && out_dim > 0,
                 "field MLP: point_dim and out_dim must be positive, code_dim not negative");
  FREETALK_CHECK(num_layers >= 2, "field MLP: num_layers must be at least 2, found ", num_layers);
  FREETALK_CHECK(hidden > input_dim(), "field MLP: hidden = ", hidden, " must exceed the inputs' ",
                 input_dim(), " channels, which join again in the middle");
  FREETALK_CHECK(beta > 0, "field MLP: beta must be positive, found ", beta);
}

std::pair<int64_t, int64_t> FieldMlpOptions::layer_dims(int64_t layer) const {
  const int64_t in = layer == 0 ? input_dim() : hidden;
  const int64_t out = layer == num_layers         ? out_dim
                      : layer + 1 == skip_layer() ? hidden - input_dim()
                                                  : hidden;
  return {in, out};
}

FieldMlpImpl::FieldMlpImpl(const FieldMlpOptions& options) : options_(options) {
  options.check();
  for (int64_t layer = 0; layer <= options.num_layers; ++layer) {
    const auto [in, out] = options.layer_dims(layer);
    layers_.push_back(register_module("lin" + std::to_string(layer), torch::nn::Linear(in, out)));
  }
}

void FieldMlpImpl::check_inputs(const at::Tensor& points, const at::Tensor& codes) const {
  FREETALK_CHECK(points.dim() == 3 && points.size(2) == options_.point_dim,
                 "field MLP: expected points (B, N, ", options_.point_dim, "), found ",
                 points.sizes());
  FREETALK_CHECK(
      codes.dim() == 2 && codes.size(0) == points.size(0) && codes.size(1) == options_.code_dim,
      "field MLP: expected codes (", points.size(0), ", ", options_.code_dim, "), found ",
      codes.sizes());
}

at::Tensor FieldMlpImpl::from_inputs(int64_t layer, const at::Tensor& points,
                                     const at::Tensor& codes) {
  const torch::nn::Linear& linear = layers_[static_cast<size_t>(layer)];
  const Columns columns = columns_of(options_, layer, linear->weight);
  if (!columns.points.defined()) return linear->bias;
  const core::NoAutocastScope no_autocast;
  const at::Tensor bias =
      at::addmm(linear->bias, codes, columns.codes.t()).unsqueeze(1);  // (B, 1, out)
  return points.matmul(columns.points.t()) + bias;
}

at::Tensor FieldMlpImpl::forward(const at::Tensor& points, const at::Tensor& codes) {
  check_inputs(points, codes);
  at::Tensor x = softplus(from_inputs(0, points, codes), options_.beta);  // (B, N, hidden)
  for (int64_t layer = 1; layer < options_.num_layers; ++layer) {
    const auto columns = columns_of(options_, layer, layers_[static_cast<size_t>(layer)]->weight);
    const at::ScalarType dtype = product_dtype(x);
    x = x.to(dtype).matmul(columns.hidden.to(dtype).t()) + from_inputs(layer, points, codes);
    x = softplus(x, options_.beta);
  }
  const core::NoAutocastScope no_autocast;
  const torch::nn::Linear& last = layers_.back();
  return at::linear(x.to(last->weight.scalar_type()), last->weight, last->bias);
}

std::pair<at::Tensor, at::Tensor> FieldMlpImpl::with_jacobian(const at::Tensor& points,
                                                              const at::Tensor& codes,
                                                              int64_t directions) {
  check_inputs(points, codes);
  const core::NoAutocastScope no_autocast;
  at::Tensor x, tangents;  // (B, N, C), (B, N, directions, C)
  for (int64_t layer = 0; layer <= options_.num_layers; ++layer) {
    const auto columns = columns_of(options_, layer, layers_[static_cast<size_t>(layer)]->weight);
    const bool joins = columns.points.defined();
    at::Tensor y = from_inputs(layer, points, codes);
    at::Tensor dy;
    if (joins) dy = columns.points.narrow(1, 0, directions).t();
    if (x.defined()) {
      y = x.matmul(columns.hidden.t()) + y;
      const at::Tensor product = tangents.matmul(columns.hidden.t());
      dy = joins ? product + dy : product;
    }
    if (layer == options_.num_layers) return {y, dy.transpose(2, 3)};
    x = softplus(y, options_.beta);
    tangents = at::sigmoid(y * options_.beta).unsqueeze(2) * dy;
  }
  return {};
}

EnsembledFieldMlpImpl::EnsembledFieldMlpImpl(int64_t num_members, int64_t num_pairs,
                                             const FieldMlpOptions& options)
    : options_(options), num_members_(num_members), num_pairs_(num_pairs) {
  options.check();
  for (int64_t layer = 0; layer <= options.num_layers; ++layer) {
    const auto [in, out] = options.layer_dims(layer);
    layers_.push_back(register_module("lin" + std::to_string(layer),
                                      EnsembledLinear(num_members, num_pairs, in, out)));
  }
}

at::Tensor EnsembledFieldMlpImpl::forward(const EnsembleRows& rows, const at::Tensor& codes) {
  FREETALK_CHECK(
      codes.dim() == 3 && codes.size(0) == num_members_ && codes.size(2) == options_.code_dim,
      "ensembled field MLP: expected codes (", num_members_, ", B, ", options_.code_dim,
      "), found ", codes.sizes());
  const int64_t batch = codes.size(1), segments = num_members_ * batch;
  FREETALK_CHECK(static_cast<int64_t>(rows.first.size()) == segments + 1 &&
                     rows.points.dim() == 2 && rows.points.size(1) == options_.point_dim &&
                     rows.points.size(0) == rows.first.back(),
                 "ensembled field MLP: expected ", segments + 1, " first rows of points (R, ",
                 options_.point_dim, "), found ", rows.first.size(), " of ", rows.points.sizes());
  const auto networks = networks_of_members(num_members_, num_pairs_);
  std::vector<int64_t> first_of_network(static_cast<size_t>(networks.back()) + 2, 0), counts;
  for (int64_t segment = 0; segment < segments; ++segment) {
    const auto s = static_cast<size_t>(segment);
    counts.push_back(rows.first[s + 1] - rows.first[s]);
    first_of_network[static_cast<size_t>(networks[static_cast<size_t>(segment / batch)]) + 1] =
        rows.first[s + 1];
  }
  const auto device = rows.points.device();
  const at::Tensor network = at::tensor(networks, at::kLong).to(device);
  const at::Tensor segment_of_row = at::repeat_interleave(
      at::arange(segments, at::kLong).to(device), at::tensor(counts, at::kLong).to(device));
  const at::Tensor network_of_row = network.index_select(0, segment_of_row.floor_divide(batch));

  at::Tensor x;
  for (int64_t layer = 0; layer <= options_.num_layers; ++layer) {
    const EnsembledLinear& linear = layers_[static_cast<size_t>(layer)];
    const Columns columns = columns_of(options_, layer, linear->weight);
    const bool last = layer == options_.num_layers;
    at::Tensor y;
    if (x.defined()) {
      const at::ScalarType dtype = last ? linear->weight.scalar_type() : product_dtype(x);
      const core::NoAutocastScope no_autocast;
      y = grouped_product(x.to(dtype), columns.hidden.to(dtype), first_of_network);
    }
    const core::NoAutocastScope no_autocast;
    if (columns.points.defined()) {
      const at::Tensor table =  // (M, B, out)
          at::baddbmm(linear->bias.index_select(0, network).unsqueeze(1), codes,
                      columns.codes.index_select(0, network).transpose(1, 2));
      const at::Tensor added = grouped_product(rows.points, columns.points, first_of_network) +
                               at::embedding(table.flatten(0, 1), segment_of_row);
      y = y.defined() ? y + added : added;
    } else {
      y = y + at::embedding(linear->bias, network_of_row);
    }
    x = last ? y : softplus(y, options_.beta);
  }
  return x;
}

}  // namespace freetalk::nn
