// STM, Sparse-To-Mesh [FreeTalk 3.2]: landmark displacements + a static mesh of any topology ->
// vertex displacements.
//
//   f_i = E_M(v_i, n_i)                       DiffusionNet (or another), once a mesh
//   l~_tj = phi([GCN(dL_t)_j | PE(j)])        [Eq. 12]
//   c_ti = sum_j softmax_j(q_i . k_tj / sqrt(d_c)) v_tj   [Eq. 13-14, per head]
//   dV_t = D([f_i, g_t, c_ti])                DiffusionNet (or another), g_t = dL_t
//
// Lengths: the mesh is in metres in the canonical frame; positions enter as v / length_scale and
// the operators are those of the mesh divided by length_scale, displacements as d /
// displacement_scale.
#pragma once

#include <torch/nn/module.h>
#include <torch/nn/modules/linear.h>
#include <torch/nn/pimpl.h>

#include <array>
#include <functional>
#include <memory>
#include <string>

#include "freetalk/geometry/operators.h"
#include "freetalk/nn/surface_net.h"
#include "freetalk/stm/frame_inputs.h"
#include "freetalk/stm/landmark_graph.h"

namespace freetalk::stm {

struct StmOptions {
  int64_t encoder_width = 128;        // [supp. 2]
  int64_t encoder_blocks = 4;         // unstated
  int64_t feature_dim = 128;          // d, channels of f_i [supp. 2]
  int64_t decoder_width = 128;        // [supp. 2]
  int64_t decoder_blocks = 4;         // unstated
  double dropout = 0.0;               // of both DiffusionNets
  int64_t k_eig = 128;                // K, eigenpairs; unstated
  int64_t gcn_layers = 3;             // [supp. 2]
  int64_t gcn_hidden = 128;           // [supp. 2]
  int64_t index_code_dim = 128;       // channels of PE(j), a learned table
  int64_t attention_heads = 4;        // [supp. 2]
  int64_t attention_dim = 128;        // d_c over all heads [supp. 2]
  double length_scale = 0.1;          // m, the unit of positions and operators
  double displacement_scale = 0.002;  // m, the unit of displacements, about their spread
  // Component substitutions [supp. Tables 1-2]; the defaults are the paper's network.
  std::string extractor = "diffusionnet";  // E_M: "mlp", "diffusionnet" or "poissonnet"
  std::string decoder = "diffusionnet";    // D: "mlp", "diffusionnet" or "njf"
  // What joins landmarks to vertices: "concat" [f_i, g_t]; "ca" [f_i, c_ti] with landmark features
  // of displacement and index alone; "ca_concat" [f_i, g_t, c_ti] with the same; "gcn_ca_concat"
  // with the graph convolutions.
  std::string fusion = "gcn_ca_concat";
  bool follows_landmarks = false;  // what it gives is made to: landmark_follower.h; paper: false
  template <class V>
  void fields(V& v) {
    v("encoder_width", encoder_width);
    v("encoder_blocks", encoder_blocks);
    v("feature_dim", feature_dim);
    v("decoder_width", decoder_width);
    v("decoder_blocks", decoder_blocks);
    v("dropout", dropout);
    v("k_eig", k_eig);
    v("gcn_layers", gcn_layers);
    v("gcn_hidden", gcn_hidden);
    v("index_code_dim", index_code_dim);
    v("attention_heads", attention_heads);
    v("attention_dim", attention_dim);
    v("length_scale", length_scale);
    v("displacement_scale", displacement_scale);
    v("extractor", extractor);
    v("decoder", decoder);
    v("fusion", fusion);
    v("follows_landmarks", follows_landmarks);
  }
  void check() const;
  bool uses_gcn() const { return fusion == "gcn_ca_concat"; }
  bool uses_attention() const { return fusion != "concat"; }
  bool uses_global_motion() const { return fusion != "ca"; }
};

/// What depends on the mesh alone, computed once.
struct MeshFeatures {
  at::Tensor hidden;   // (V, decoder_width): W_f f_i + b, its part of the decoder's first layer
  at::Tensor queries;  // (heads, V, d_head); undefined without attention
};

class StmImpl : public torch::nn::Module {
 public:
  explicit StmImpl(const StmOptions& options);

  /// @param positions (V, 3) metres, canonical frame. @param operators of positions / length_scale.
  MeshFeatures encode(const at::Tensor& positions, const geometry::SurfaceOperators& operators);

  /// @param landmarks (T, 68, 3) displacements, metres. @returns (T, V, 3) displacements, metres.
  at::Tensor decode(const MeshFeatures& mesh, const geometry::SurfaceOperators& operators,
                    const at::Tensor& landmarks);

  /// encode + decode.
  at::Tensor forward(const at::Tensor& positions, const geometry::SurfaceOperators& operators,
                     const at::Tensor& landmarks);

  /// Frames that decode() takes at once within `memory_bytes`, at least 1.
  int64_t frames_per_chunk(int64_t num_vertices, int64_t memory_bytes) const;

  /// For FrameDecoder. @param landmarks as in decode.
  FrameInputs frame_inputs(const at::Tensor& landmarks);

  const std::shared_ptr<nn::SurfaceNetImpl>& decoder() const { return decoder_; }
  const StmOptions& options() const { return options_; }

 private:
  void initialize();
  at::Tensor landmark_features(const at::Tensor& landmarks);
  /// c_ti. @param motion (T, 68, 3) scaled landmark displacements. @returns (T, V, d_c).
  at::Tensor attend(const at::Tensor& queries, const at::Tensor& motion);
  /// Columns of the decoder's first layer for f_i, g_t and c_ti; undefined where not in use.
  std::array<at::Tensor, 3> first_layer_parts();

  StmOptions options_;
  std::shared_ptr<nn::SurfaceNetImpl> encoder_, decoder_;
  Gcn gcn_{nullptr};
  torch::nn::Linear landmark_proj_{nullptr}, query_proj_{nullptr}, key_proj_{nullptr},
      value_proj_{nullptr};
  at::Tensor index_code_;  // (68, index_code_dim)
};
TORCH_MODULE(Stm);

struct DecodeOptions {
  // "float32", or "bfloat16": products in bfloat16 with float32 sums, where the processor or GPU
  // multiplies it; elsewhere float32.
  std::string precision = "float32";
  // Working memory; the least is that of one frame. On a GPU half of what is free is taken where
  // that is more, up to 4 GiB.
  int64_t memory_bytes = int64_t{256} << 20;
  template <class V>
  void fields(V& v) {
    v("precision", precision);
    v("memory_bytes", memory_bytes);
  }
  void check() const;
};

/// Decodes any number of frames without gradients (see FrameDecoder for several sequences of one
/// mesh): memory grows with the chunk, not with T.
/// @param sink called with (first frame, (t, V, 3) displacements in metres) in order, on the CPU.
void decode_chunked(Stm& model, const MeshFeatures& mesh,
                    const geometry::SurfaceOperators& operators, const at::Tensor& landmarks,
                    const std::function<void(int64_t, const at::Tensor&)>& sink,
                    const DecodeOptions& options = {});

}  // namespace freetalk::stm
