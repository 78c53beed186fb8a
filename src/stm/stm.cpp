#include "freetalk/stm/stm.h"

#include <torch/torch.h>

#include <cmath>

#include "freetalk/core/error.h"

namespace freetalk::stm {
namespace {

constexpr int64_t kNumLandmarks = 68;
constexpr int64_t kMotionDim = 3 * kNumLandmarks;  // D

}  // namespace

void StmOptions::check() const {
  FREETALK_CHECK(encoder_width > 0 && encoder_blocks > 0 && feature_dim > 0 && decoder_width > 0 &&
                     decoder_blocks > 0,
                 "STM: widths and numbers of blocks must be positive");
  FREETALK_CHECK(gcn_layers > 0 && gcn_hidden > 0,
                 "STM: gcn_layers and gcn_hidden must be positive");
  FREETALK_CHECK(index_code_dim > 0, "STM: index_code_dim must be positive, found ",
                 index_code_dim);
  FREETALK_CHECK(attention_heads > 0 && attention_dim > 0 && attention_dim % attention_heads == 0,
                 "STM: attention_dim (", attention_dim,
                 ") must be a positive multiple of attention_heads (", attention_heads, ")");
  FREETALK_CHECK(k_eig > 0, "STM: k_eig must be positive, found ", k_eig);
  FREETALK_CHECK(length_scale > 0 && displacement_scale > 0,
                 "STM: length_scale and displacement_scale must be positive");
  FREETALK_CHECK(dropout >= 0 && dropout < 1, "STM: dropout must be in [0, 1), found ", dropout);
}

StmImpl::StmImpl(const StmOptions& options) : options_(options) {
  options.check();
  encoder_ = register_module("encoder", nn::DiffusionNet(nn::DiffusionNetOptions{
                                            6, options.feature_dim, options.encoder_width,
                                            options.encoder_blocks, options.dropout}));
  gcn_ = register_module("gcn", nn::Gcn(3, options.gcn_hidden, options.gcn_layers));
  const int64_t d = options.attention_dim;
  landmark_proj_ = register_module(
      "landmark_proj", torch::nn::Linear(options.gcn_hidden + options.index_code_dim, d));
  query_proj_ = register_module("query_proj", torch::nn::Linear(options.feature_dim, d));
  key_proj_ = register_module("key_proj", torch::nn::Linear(d, d));
  value_proj_ = register_module("value_proj", torch::nn::Linear(d, d));
  decoder_ =
      register_module("decoder", nn::DiffusionNet(nn::DiffusionNetOptions{
                                     options.feature_dim + kMotionDim + d, 3, options.decoder_width,
                                     options.decoder_blocks, options.dropout}));
  index_code_ =
      register_parameter("index_code", torch::randn({kNumLandmarks, options.index_code_dim}));
  initialize();
}

void StmImpl::initialize() {
  // torch's default shrinks every layer by sqrt(3), and averaging over the landmark graph shrinks
  // motion further: after seven layers attention would be uniform and blind to motion. These gains
  // keep mesh, motion and logits near one.
  const torch::NoGradGuard no_grad;
  const auto scaled_normal = [](at::Tensor weight, double gain) {
    weight.normal_(0, gain / std::sqrt(static_cast<double>(weight.size(1))));
  };
  encoder_->last_lin->weight.mul_(6.0);
  for (const auto& item : gcn_->named_parameters()) {
    if (item.value().dim() == 2) scaled_normal(item.value(), 2.5);
  }
  scaled_normal(landmark_proj_->weight, 1.4);
  scaled_normal(query_proj_->weight, 1.5);
  scaled_normal(key_proj_->weight, 1.5);
  scaled_normal(value_proj_->weight, 1.0);
  int64_t first = 0;
  for (const int64_t columns : {options_.feature_dim, kMotionDim, options_.attention_dim}) {
    scaled_normal(decoder_->first_lin->weight.narrow(1, first, columns), 1.0);
    first += columns;
  }
  decoder_->last_lin->weight.zero_();
  decoder_->last_lin->bias.zero_();
}

MeshFeatures StmImpl::encode(const at::Tensor& positions,
                             const geometry::SurfaceOperators& operators) {
  const int64_t vertices = operators.mass.size(0);
  FREETALK_CHECK(positions.dim() == 2 && positions.size(0) == vertices && positions.size(1) == 3,
                 "STM: expected positions (", vertices, ", 3), found ", positions.sizes());
  FREETALK_CHECK(operators.evals.size(0) == options_.k_eig,
                 "STM: expected operators with k = ", options_.k_eig, " eigenpairs, found ",
                 operators.evals.size(0));
  const at::Tensor input =
      at::cat({positions / options_.length_scale, operators.normals}, 1).unsqueeze(0);
  const at::Tensor features = encoder_(input, operators).squeeze(0);  // (V, d)
  const at::Tensor weight = decoder_->first_lin->weight.narrow(1, 0, options_.feature_dim);
  const int64_t heads = options_.attention_heads;
  return {at::linear(features, weight, decoder_->first_lin->bias),
          query_proj_(features).view({vertices, heads, -1}).transpose(0, 1)};
}

at::Tensor StmImpl::landmark_features(const at::Tensor& landmarks) {
  const at::Tensor local = gcn_(landmarks);  // (T, 68, gcn_hidden)
  return landmark_proj_(at::cat(
      {local, index_code_.to(local.scalar_type()).expand({landmarks.size(0), -1, -1})}, -1));
}

at::Tensor StmImpl::decode(const MeshFeatures& mesh, const geometry::SurfaceOperators& operators,
                           const at::Tensor& landmarks) {
  FREETALK_CHECK(
      landmarks.dim() == 3 && landmarks.size(1) == kNumLandmarks && landmarks.size(2) == 3,
      "STM: expected landmarks (T, 68, 3), found ", landmarks.sizes());
  const int64_t frames = landmarks.size(0), heads = options_.attention_heads,
                d = options_.attention_dim;
  const at::Tensor motion = landmarks / options_.displacement_scale;
  const at::Tensor features = landmark_features(motion);  // (T, 68, d)
  const auto split_heads = [&](const at::Tensor& x) {
    return x.view({frames, kNumLandmarks, heads, d / heads})
        .transpose(1, 2);  // (T, heads, 68, d_head)
  };
  const at::Tensor queries = mesh.queries.unsqueeze(0).expand({frames, -1, -1, -1});
  const at::Tensor attended = at::scaled_dot_product_attention(
      queries, split_heads(key_proj_(features)), split_heads(value_proj_(features)));
  // The decoder's first layer over [f_i, g_t, c_ti], split into its three parts.
  const at::Tensor weight = decoder_->first_lin->weight;
  const at::Tensor global =
      at::linear(motion.flatten(1), weight.narrow(1, options_.feature_dim, kMotionDim))
          .unsqueeze(1);  // (T, 1, width)
  const at::Tensor local = at::linear(attended.transpose(1, 2).flatten(-2),
                                      weight.narrow(1, options_.feature_dim + kMotionDim, d));
  return decoder_->forward_hidden(local + global + mesh.hidden.unsqueeze(0), operators) *
         options_.displacement_scale;
}

at::Tensor StmImpl::forward(const at::Tensor& positions,
                            const geometry::SurfaceOperators& operators,
                            const at::Tensor& landmarks) {
  return decode(encode(positions, operators), operators, landmarks);
}

int64_t StmImpl::frames_per_chunk(int64_t num_vertices, int64_t memory_bytes) const {
  const int64_t channels = 12 * options_.decoder_width + 4 * options_.attention_dim;
  return std::max<int64_t>(1, memory_bytes / std::max<int64_t>(1, num_vertices * channels * 4));
}

void decode_chunked(Stm& model, const MeshFeatures& mesh,
                    const geometry::SurfaceOperators& operators, const at::Tensor& landmarks,
                    const std::function<void(int64_t, const at::Tensor&)>& sink,
                    int64_t memory_bytes) {
  const torch::NoGradGuard no_grad;
  const int64_t chunk = model->frames_per_chunk(operators.mass.size(0), memory_bytes);
  for (int64_t first = 0; first < landmarks.size(0); first += chunk) {
    const int64_t count = std::min(chunk, landmarks.size(0) - first);
    sink(first, model->decode(mesh, operators, landmarks.narrow(0, first, count)));
  }
}

}  // namespace freetalk::stm
