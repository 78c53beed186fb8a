#include "freetalk/diffusion/schedule.h"

#include <ATen/ATen.h>

#include <cmath>

#include "freetalk/core/error.h"

namespace freetalk::diffusion {

void ScheduleOptions::check() const {
  FREETALK_CHECK(kind == "linear" || kind == "cosine",
                 "schedule kind must be linear or cosine, found ", kind);
  FREETALK_CHECK(num_steps > 0, "schedule num_steps must be positive, found ", num_steps);
  FREETALK_CHECK(0 < beta_start && beta_start <= beta_end && beta_end < 1,
                 "schedule betas must satisfy 0 < beta_start <= beta_end < 1, found ", beta_start,
                 ", ", beta_end);
}

Schedule::Schedule(const ScheduleOptions& options) : options_(options) {
  options.check();
  at::Tensor betas;
  if (options.kind == "linear") {
    betas = at::linspace(options.beta_start, options.beta_end, options.num_steps, at::kDouble);
  } else {
    const at::Tensor time =
        at::arange(options.num_steps + 1, at::kDouble) / static_cast<double>(options.num_steps);
    const at::Tensor curve = at::cos((time + 0.008) / 1.008 * (M_PI / 2)).square();
    betas = (1 - curve.slice(0, 1) / curve.slice(0, 0, -1)).clamp(0, 0.999);
  }
  alphas_cumprod_ = at::cumprod(1 - betas, 0);
}

at::Tensor Schedule::q_sample(const at::Tensor& x0, const at::Tensor& timestep,
                              const at::Tensor& noise) const {
  FREETALK_CHECK(timestep.dim() == 1 && timestep.size(0) == x0.size(0),
                 "q_sample: expected timestep (", x0.size(0), ",), found ", timestep.sizes());
  FREETALK_CHECK(noise.sizes() == x0.sizes(), "q_sample: expected noise ", x0.sizes(), ", found ",
                 noise.sizes());
  std::vector<int64_t> shape(static_cast<size_t>(x0.dim()), 1);
  shape[0] = x0.size(0);
  const at::Tensor alpha_bar =
      alphas_cumprod_.to(timestep.device()).index_select(0, timestep).view(shape);
  return alpha_bar.sqrt().to(x0.options()) * x0 + (1 - alpha_bar).sqrt().to(x0.options()) * noise;
}

double Schedule::alpha_bar(int64_t timestep) const {
  FREETALK_CHECK(timestep >= -1 && timestep < options_.num_steps, "timestep must be in [-1, ",
                 options_.num_steps, "), found ", timestep);
  return timestep < 0 ? 1.0 : alphas_cumprod_.const_data_ptr<double>()[timestep];
}

}  // namespace freetalk::diffusion
