// Options of a neural parametric head. The defaults are FaceTalk's head: NPHM's sizes, with a
// deformation from the posed to the canonical face.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "freetalk/head/deformation_field.h"
#include "freetalk/head/identity_field.h"

namespace freetalk::head {

struct HeadOptions {
  int64_t global_dim = 64;           // z_glob [NPHM]
  int64_t local_dim = 32;            // each local code [NPHM]
  int64_t num_anchors = 39;          // [NPHM]
  int64_t num_pairs = 16;            // mirrored pairs of anchors, which come first [NPHM]
  int64_t identity_hidden = 200;     // local networks [NPHM]
  int64_t identity_layers = 4;       // [NPHM]
  int64_t anchor_hidden = 256;       // of the anchors' MLP; 128 in some published files
  int64_t expression_dim = 200;      // z_exp [NPHM]
  int64_t identity_code_dim = 32;    // [z_id | anchors] compressed for the deformation [NPHM]
  int64_t deformation_hidden = 512;  // [NPHM]
  int64_t deformation_layers = 6;    // [NPHM]
  /// "backward": posed to canonical, as FaceTalk; "forward": canonical to posed, as the published
  /// NPHM; "both": one network each way, under the same codes.
  std::string direction = "backward";
  /// What the identity field sees of the expression: "none"; "hyper": hyper_dim coordinates that
  /// the backward network adds to the point; "expression": z_exp itself [FaceTalk 5].
  std::string identity_sees = "none";
  int64_t hyper_dim = 2;               // of identity_sees "hyper"
  double identity_noise = 0.0;         // see DeformationOptions; NPHM: 0.005
  double kernel_width = 0.1;           // see IdentityOptions [NPHM]
  double normalizer_eps = 1e-6;        // see IdentityOptions [NPHM]
  double min_weight = 1e-3;            // see IdentityOptions; 0: every local network everywhere
  std::string background = "learned";  // see IdentityOptions; NPHM evaluates "outside"
  double units_per_metre = 4.0;        // head units in a metre [NPHM]
  std::vector<double> box_min = {-0.55, -0.5, -0.95};  // of the surface, head units [NPHM]
  std::vector<double> box_max = {0.55, 0.75, 0.4};
  /// Coefficients of a face model, such as ICT's identity shapes, that identity_map turns into
  /// z_id; 0: no map.
  int64_t num_coefficients = 0;
  /// Expression weights of a face model that expression_map turns into z_exp; 0: no map.
  int64_t num_weights = 0;
  std::vector<std::string> expressions;  // their names, as the face model has them; or none
  int64_t expression_map_hidden = 128;
  template <class V>
  void fields(V& v) {
    v("global_dim", global_dim);
    v("local_dim", local_dim);
    v("num_anchors", num_anchors);
    v("num_pairs", num_pairs);
    v("identity_hidden", identity_hidden);
    v("identity_layers", identity_layers);
    v("anchor_hidden", anchor_hidden);
    v("expression_dim", expression_dim);
    v("identity_code_dim", identity_code_dim);
    v("deformation_hidden", deformation_hidden);
    v("deformation_layers", deformation_layers);
    v("direction", direction);
    v("identity_sees", identity_sees);
    v("hyper_dim", hyper_dim);
    v("identity_noise", identity_noise);
    v("kernel_width", kernel_width);
    v("normalizer_eps", normalizer_eps);
    v("min_weight", min_weight);
    v("background", background);
    v("units_per_metre", units_per_metre);
    v("box_min", box_min);
    v("box_max", box_max);
    v("num_coefficients", num_coefficients);
    v("num_weights", num_weights);
    v("expressions", expressions);
    v("expression_map_hidden", expression_map_hidden);
  }
  void check() const;
  bool has_backward() const { return direction != "forward"; }
  bool has_forward() const { return direction != "backward"; }
  IdentityOptions identity() const;
  /// Of the network from posed to canonical points, or of the other one.
  DeformationOptions deformation(bool backward) const;
};

/// The published NPHM: forward, the background outside when it is evaluated.
HeadOptions nphm_paper_options();
/// The head that ships: 1.3 million weights, both directions, maps of ICT's 100 identity and
/// 53 expression weights.
HeadOptions nphm_small_options();

}  // namespace freetalk::head
