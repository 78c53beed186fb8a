#include "freetalk/head/options.h"

#include "freetalk/core/error.h"

namespace freetalk::head {

IdentityOptions HeadOptions::identity() const {
  IdentityOptions result;
  result.global_dim = global_dim;
  result.local_dim = local_dim;
  result.num_anchors = num_anchors;
  result.num_pairs = num_pairs;
  result.hidden = identity_hidden;
  result.num_layers = identity_layers;
  result.anchor_hidden = anchor_hidden;
  result.hyper_dim = identity_sees == "hyper" ? hyper_dim : 0;
  result.expression_dim = identity_sees == "expression" ? expression_dim : 0;
  result.kernel_width = kernel_width;
  result.normalizer_eps = normalizer_eps;
  result.min_weight = min_weight;
  result.background = background;
  return result;
}

DeformationOptions HeadOptions::deformation(bool backward) const {
  DeformationOptions result;
  result.identity_dim = identity().code_dim() + 3 * num_anchors;
  result.identity_code_dim = identity_code_dim;
  result.expression_dim = expression_dim;
  result.hidden = deformation_hidden;
  result.num_layers = deformation_layers;
  result.hyper_dim = backward && identity_sees == "hyper" ? hyper_dim : 0;
  result.identity_noise = identity_noise;
  return result;
}

void HeadOptions::check() const {
  FREETALK_CHECK(direction == "backward" || direction == "forward" || direction == "both",
                 "direction must be backward, forward or both, found ", direction);
  FREETALK_CHECK(
      identity_sees == "none" || identity_sees == "hyper" || identity_sees == "expression",
      "identity_sees must be none, hyper or expression, found ", identity_sees);
  FREETALK_CHECK(identity_sees != "hyper" || (hyper_dim > 0 && has_backward()),
                 "identity_sees hyper needs a positive hyper_dim and a backward network");
  FREETALK_CHECK(units_per_metre > 0, "units_per_metre must be positive, found ", units_per_metre);
  FREETALK_CHECK(box_min.size() == 3 && box_max.size() == 3 && box_min[0] < box_max[0] &&
                     box_min[1] < box_max[1] && box_min[2] < box_max[2],
                 "box_min must be below box_max in each of three coordinates");
  FREETALK_CHECK(num_coefficients >= 0 && num_weights >= 0 && expression_map_hidden > 0,
                 "num_coefficients and num_weights must not be negative, expression_map_hidden "
                 "must be positive");
  identity().check();
  deformation(true).check();
}

HeadOptions nphm_paper_options() {
  HeadOptions options;
  options.direction = "forward";
  options.background = "outside";
  options.identity_noise = 0.005;
  return options;
}

HeadOptions nphm_small_options() {
  HeadOptions options;
  options.global_dim = 32;
  options.local_dim = 16;
  options.identity_hidden = 96;
  options.anchor_hidden = 128;
  options.expression_dim = 64;
  options.identity_code_dim = 16;
  options.deformation_hidden = 256;
  options.deformation_layers = 5;
  options.direction = "both";
  options.normalizer_eps = 1e-14;  // below the background's weight: a distance everywhere
  options.num_coefficients = 100;
  options.num_weights = 53;
  return options;
}

}  // namespace freetalk::head
