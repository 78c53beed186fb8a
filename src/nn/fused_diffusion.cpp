#include "nn/fused_diffusion.h"

#include <algorithm>

#include "freetalk/core/error.h"
#include "fused_engine.h"

namespace freetalk::nn {
namespace {

bool all_float_on_cpu(DiffusionNetImpl& net, const geometry::SurfaceOperators& operators) {
  const auto fits = [](const at::Tensor& t) { return t.is_cpu() && t.scalar_type() == at::kFloat; };
  const auto parameters = net.parameters();
  return fits(operators.mass) && fits(operators.evecs) &&
         std::all_of(parameters.begin(), parameters.end(), fits);
}

}  // namespace

bool FusedDiffusion::supports(DiffusionNetImpl& net, const geometry::SurfaceOperators& operators) {
  const DiffusionNetOptions& options = net.options();
  const bool equal_widths =
      options.mlp_hidden.empty() ||
      options.mlp_hidden == std::vector<int64_t>{options.width, options.width};
  return options.diffusion_method == "spectral" && options.with_gradient_features &&
         options.with_gradient_rotations && equal_widths && options.outputs_at == "vertices" &&
         operators.offsets.empty() && !(net.is_training() && options.dropout > 0) &&
         all_float_on_cpu(net, operators);
}

bool FusedDiffusion::supports_bfloat16() { return kernels::bfloat16_kernels() != nullptr; }

FusedDiffusion::FusedDiffusion(DiffusionNetImpl& net, const geometry::SurfaceOperators& operators,
                               const FusedInput& input, bool bfloat16) {
  FREETALK_CHECK(supports(net, operators),
                 "FusedDiffusion: this network or these operators need the general forward pass");
  if (bfloat16 && supports_bfloat16()) {
    engine_ = std::make_unique<fused::FusedEngine<uint16_t>>(*kernels::bfloat16_kernels(), net,
                                                             operators, input);
  } else {
    engine_ = std::make_unique<fused::FusedEngine<float>>(kernels::float_kernels(), net, operators,
                                                          input);
  }
}

FusedDiffusion::~FusedDiffusion() = default;
FusedDiffusion::FusedDiffusion(FusedDiffusion&&) noexcept = default;
FusedDiffusion& FusedDiffusion::operator=(FusedDiffusion&&) noexcept = default;

at::Tensor FusedDiffusion::run(const FrameInputs& inputs, int64_t num_frames,
                               int64_t in_work) const {
  FREETALK_CHECK(num_frames > 0 && in_work > 0, "FusedDiffusion: frames must be positive, found ",
                 num_frames, " and ", in_work);
  FREETALK_CHECK(!inputs.keys.defined() || inputs.keys.size(2) <= fused::kMaxKeys,
                 "FusedDiffusion: at most ", fused::kMaxKeys, " keys, found ", inputs.keys.size(2));
  const torch::NoGradGuard no_grad;
  return engine_->run(inputs, num_frames, in_work);
}

int64_t FusedDiffusion::bytes_per_frame() const { return engine_->bytes_per_frame(); }

}  // namespace freetalk::nn
