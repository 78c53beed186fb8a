#include "freetalk/diffusion/ddim.h"

#include <ATen/ATen.h>

#include <cmath>

#include "freetalk/core/error.h"

namespace freetalk::diffusion {

void DdimOptions::check() const {
  FREETALK_CHECK(num_steps > 0, "DDIM num_steps must be positive, found ", num_steps);
  FREETALK_CHECK(eta >= 0 && eta <= 1, "DDIM eta must be in [0, 1], found ", eta);
  FREETALK_CHECK(spacing == "trailing" || spacing == "leading" || spacing == "linspace",
                 "DDIM spacing must be trailing, leading or linspace, found ", spacing);
}

std::vector<int64_t> ddim_timesteps(int64_t num_train_steps, const DdimOptions& options) {
  options.check();
  const int64_t count = options.num_steps;
  FREETALK_CHECK(count <= num_train_steps, "DDIM num_steps (", count, ") exceeds the schedule's ",
                 num_train_steps);
  std::vector<int64_t> timesteps(static_cast<size_t>(count));
  for (int64_t i = 0; i < count; ++i) {
    const double remaining = static_cast<double>(count - i) / static_cast<double>(count);
    int64_t& timestep = timesteps[static_cast<size_t>(i)];
    if (options.spacing == "trailing") {
      timestep = std::lround(remaining * static_cast<double>(num_train_steps)) - 1;
    } else if (options.spacing == "leading") {
      timestep = (count - 1 - i) * (num_train_steps / count);
    } else {
      const double fraction =
          count > 1 ? static_cast<double>(count - 1 - i) / static_cast<double>(count - 1) : 1.0;
      timestep = std::lround(fraction * static_cast<double>(num_train_steps - 1));
    }
  }
  return timesteps;
}

at::Tensor ddim_sample(const Schedule& schedule, const Denoiser& denoiser, const at::Tensor& noise,
                       const DdimOptions& options, at::Generator generator,
                       const StepCallback& on_step) {
  const auto timesteps = ddim_timesteps(schedule.options().num_steps, options);
  at::Tensor x = noise, x0;
  for (size_t i = 0; i < timesteps.size(); ++i) {
    const double a = schedule.alpha_bar(timesteps[i]);
    const double a_next = schedule.alpha_bar(i + 1 < timesteps.size() ? timesteps[i + 1] : -1);
    x0 = denoiser(x, timesteps[i]);
    const at::Tensor eps = (x - std::sqrt(a) * x0) / std::sqrt(1 - a);
    const double sigma =
        options.eta * std::sqrt((1 - a_next) / (1 - a)) * std::sqrt(1 - a / a_next);
    x = std::sqrt(a_next) * x0 + std::sqrt(std::max(0.0, 1 - a_next - sigma * sigma)) * eps;
    if (sigma > 0) x = x + sigma * at::randn(x.sizes(), generator, x.options());
    if (on_step) on_step(static_cast<int64_t>(i) + 1, static_cast<int64_t>(timesteps.size()));
  }
  return x0;
}

}  // namespace freetalk::diffusion
