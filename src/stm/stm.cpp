#include "freetalk/stm/stm.h"

#include <torch/torch.h>

#include <algorithm>
#include <cmath>

#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "freetalk/core/options.h"
#include "freetalk/core/torch_error.h"
#include "freetalk/nn/diffusion_net.h"
#include "freetalk/nn/jacobian_field.h"
#include "freetalk/nn/mlp.h"
#include "freetalk/nn/poisson_net.h"

namespace freetalk::stm {
namespace {

using core::kMotionDim;
using core::kNumLandmarks;
constexpr int64_t kMeshDim = 6;  // position and normal

void check_name(const char* option, const std::string& value,
                const std::vector<std::string>& known) {
  std::string list;
  for (const std::string& name : known) list += (list.empty() ? "" : ", ") + name;
  FREETALK_CHECK(std::find(known.begin(), known.end(), value) != known.end(), "STM: unknown ",
                 option, " \"", value, "\"; known: ", list, "; did you mean \"",
                 core::nearest_name(value, known), "\"?");
}

void check_landmarks(const at::Tensor& landmarks) {
  FREETALK_CHECK(
      landmarks.dim() == 3 && landmarks.size(1) == kNumLandmarks && landmarks.size(2) == 3,
      "STM: expected landmarks (T, 68, 3), found ", landmarks.sizes());
}

std::shared_ptr<nn::SurfaceNetImpl> make_net(const std::string& kind, int64_t in_channels,
                                             int64_t out_channels, int64_t width, int64_t blocks,
                                             double dropout) {
  if (kind == "mlp") {
    return std::make_shared<nn::VertexMlpImpl>(
        nn::VertexMlpOptions{in_channels, out_channels, width, blocks, dropout});
  }
  if (kind == "poissonnet") {
    return std::make_shared<nn::PoissonNetImpl>(
        nn::PoissonNetOptions{in_channels, out_channels, width, blocks, dropout});
  }
  if (kind == "njf") {
    return std::make_shared<nn::JacobianFieldImpl>(
        nn::JacobianFieldOptions{in_channels, width, blocks, dropout, /*translation=*/true});
  }
  nn::DiffusionNetOptions options;
  options.in_channels = in_channels;
  options.out_channels = out_channels;
  options.width = width;
  options.num_blocks = blocks;
  options.dropout = dropout;
  return std::make_shared<nn::DiffusionNetImpl>(options);
}

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
  check_name("extractor", extractor, {"mlp", "diffusionnet", "poissonnet"});
  check_name("decoder", decoder, {"mlp", "diffusionnet", "njf"});
  check_name("fusion", fusion, {"concat", "ca", "ca_concat", "gcn_ca_concat"});
}

StmImpl::StmImpl(const StmOptions& options) : options_(options) {
  options.check();
  encoder_ = register_module(
      "encoder", make_net(options.extractor, kMeshDim, options.feature_dim, options.encoder_width,
                          options.encoder_blocks, options.dropout));
  if (options.uses_gcn()) {
    gcn_ = register_module("gcn", Gcn(3, options.gcn_hidden, options.gcn_layers));
  }
  const int64_t d = options.attention_dim;
  int64_t decoder_channels = options.feature_dim + (options.uses_global_motion() ? kMotionDim : 0);
  if (options.uses_attention()) {
    decoder_channels += d;
    const int64_t local = options.uses_gcn() ? options.gcn_hidden : 3;
    landmark_proj_ =
        register_module("landmark_proj", torch::nn::Linear(local + options.index_code_dim, d));
    query_proj_ = register_module("query_proj", torch::nn::Linear(options.feature_dim, d));
    key_proj_ = register_module("key_proj", torch::nn::Linear(d, d));
    value_proj_ = register_module("value_proj", torch::nn::Linear(d, d));
  }
  decoder_ = register_module("decoder",
                             make_net(options.decoder, decoder_channels, 3, options.decoder_width,
                                      options.decoder_blocks, options.dropout));
  if (options.uses_attention()) {
    index_code_ =
        register_parameter("index_code", torch::randn({kNumLandmarks, options.index_code_dim}));
  }
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
  encoder_->last_layer()->weight.mul_(6.0);
  if (options_.uses_gcn()) {
    for (const auto& item : gcn_->named_parameters()) {
      if (item.value().dim() == 2) scaled_normal(item.value(), 2.5);
    }
  }
  if (options_.uses_attention()) {
    scaled_normal(landmark_proj_->weight, 1.4);
    scaled_normal(query_proj_->weight, 1.5);
    scaled_normal(key_proj_->weight, 1.5);
    scaled_normal(value_proj_->weight, 1.0);
  }
  for (const at::Tensor& part : first_layer_parts()) {
    if (part.defined()) scaled_normal(part, 1.0);
  }
  decoder_->last_layer()->weight.zero_();
  decoder_->last_layer()->bias.zero_();
}

std::array<at::Tensor, 3> StmImpl::first_layer_parts() {
  const at::Tensor weight = decoder_->first_layer()->weight;
  int64_t first = 0;
  const auto next = [&](bool used, int64_t columns) {
    if (!used) return at::Tensor();
    const at::Tensor part = weight.narrow(1, first, columns);
    first += columns;
    return part;
  };
  const at::Tensor mesh = next(true, options_.feature_dim);
  const at::Tensor motion = next(options_.uses_global_motion(), kMotionDim);
  return {mesh, motion, next(options_.uses_attention(), options_.attention_dim)};
}

MeshFeatures StmImpl::encode(const at::Tensor& positions,
                             const geometry::SurfaceOperators& operators) {
  return core::with_plain_errors("STM", [&] {
    const int64_t vertices = operators.num_vertices();
    FREETALK_CHECK(positions.dim() == 2 && positions.size(0) == vertices && positions.size(1) == 3,
                   "STM: expected positions (", vertices, ", 3), found ", positions.sizes());
    FREETALK_CHECK(!(encoder_->uses_eigenbasis() || decoder_->uses_eigenbasis()) ||
                       operators.k_eig() == options_.k_eig,
                   "STM: expected operators with k = ", options_.k_eig, " eigenpairs, found ",
                   operators.k_eig());
    const at::Tensor input =
        at::cat({positions / options_.length_scale, operators.normals}, 1).unsqueeze(0);
    const at::Tensor features = encoder_->forward(input, operators).squeeze(0);  // (V, d)
    MeshFeatures mesh;
    mesh.hidden = at::linear(features, first_layer_parts()[0], decoder_->first_layer()->bias);
    if (options_.uses_attention()) {
      mesh.queries =
          query_proj_(features).view({vertices, options_.attention_heads, -1}).transpose(0, 1);
    }
    return mesh;
  });
}

at::Tensor StmImpl::landmark_features(const at::Tensor& landmarks) {
  const at::Tensor local = options_.uses_gcn() ? gcn_(landmarks) : landmarks;  // (T, 68, ...)
  return landmark_proj_(at::cat(
      {local, index_code_.to(local.scalar_type()).expand({landmarks.size(0), -1, -1})}, -1));
}

at::Tensor StmImpl::attend(const at::Tensor& queries, const at::Tensor& motion) {
  const int64_t frames = motion.size(0), heads = options_.attention_heads,
                d = options_.attention_dim;
  const at::Tensor features = landmark_features(motion);  // (T, 68, d)
  const auto split_heads = [&](const at::Tensor& x) {
    return x.view({frames, kNumLandmarks, heads, d / heads})
        .transpose(1, 2);  // (T, heads, 68, d_head)
  };
  return at::scaled_dot_product_attention(queries.unsqueeze(0).expand({frames, -1, -1, -1}),
                                          split_heads(key_proj_(features)),
                                          split_heads(value_proj_(features)))
      .transpose(1, 2)
      .flatten(-2);  // (T, V, d)
}

at::Tensor StmImpl::decode(const MeshFeatures& mesh, const geometry::SurfaceOperators& operators,
                           const at::Tensor& landmarks) {
  return core::with_plain_errors("STM", [&] {
    check_landmarks(landmarks);
    const at::Tensor motion = landmarks / options_.displacement_scale;
    // The decoder's first layer over [f_i, g_t, c_ti], split into its three parts.
    const auto parts = first_layer_parts();
    at::Tensor hidden;
    if (options_.uses_attention()) hidden = at::linear(attend(mesh.queries, motion), parts[2]);
    if (options_.uses_global_motion()) {
      const at::Tensor global = at::linear(motion.flatten(1), parts[1]).unsqueeze(1);  // (T, 1, C)
      hidden = hidden.defined() ? hidden + global : global;
    }
    return decoder_->forward_hidden(hidden + mesh.hidden.unsqueeze(0), operators) *
           options_.displacement_scale;
  });
}

at::Tensor StmImpl::forward(const at::Tensor& positions,
                            const geometry::SurfaceOperators& operators,
                            const at::Tensor& landmarks) {
  return decode(encode(positions, operators), operators, landmarks);
}

FrameInputs StmImpl::frame_inputs(const at::Tensor& landmarks) {
  return core::with_plain_errors("STM", [&] {
    check_landmarks(landmarks);
    const int64_t frames = landmarks.size(0), heads = options_.attention_heads;
    const int64_t size = options_.attention_dim / heads;
    const at::Tensor motion = landmarks / options_.displacement_scale;
    const auto parts = first_layer_parts();
    FrameInputs inputs;
    if (options_.uses_global_motion()) inputs.offsets = at::linear(motion.flatten(1), parts[1]);
    if (options_.uses_attention()) {
      const at::Tensor features = landmark_features(motion);  // (T, 68, d)
      const auto split_heads = [&](const at::Tensor& x) {
        return x.view({frames, kNumLandmarks, heads, size}).transpose(1, 2);
      };
      inputs.keys = split_heads(key_proj_(features)) / std::sqrt(static_cast<double>(size));
      inputs.values = split_heads(value_proj_(features));
    }
    return inputs;
  });
}

int64_t StmImpl::frames_per_chunk(int64_t num_vertices, int64_t memory_bytes) const {
  const int64_t channels = 12 * options_.decoder_width + 4 * options_.attention_dim;
  return std::max<int64_t>(1, memory_bytes / std::max<int64_t>(1, num_vertices * channels * 4));
}

}  // namespace freetalk::stm
