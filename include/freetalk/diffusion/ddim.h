// DDIM sampling [Song, Meng, Ermon 2021] for a denoiser that predicts x_0.
//
//   eps = (x_l - sqrt(a_l) x0) / sqrt(1 - a_l),  s = eta sqrt((1 - a_p) / (1 - a_l)) sqrt(1 - a_l /
//   a_p), x_p = sqrt(a_p) x0 + sqrt(1 - a_p - s^2) eps + s z,   a = alpha_bar, p = the next
//   timestep.
#pragma once

#include <ATen/core/Generator.h>
#include <ATen/core/Tensor.h>

#include <functional>
#include <string>
#include <vector>

#include "freetalk/diffusion/schedule.h"

namespace freetalk::diffusion {

struct DdimOptions {
  int64_t num_steps = 100;           // N, reverse steps, 1 .. T_d
  double eta = 0.0;                  // 0: deterministic; 1: as noisy as DDPM
  std::string spacing = "trailing";  // "trailing" (starts at T_d), "leading" or "linspace"
  template <class V>
  void fields(V& v) {
    v("num_steps", num_steps);
    v("eta", eta);
    v("spacing", spacing);
  }
  void check() const;
};

/// The timesteps visited, falling.
std::vector<int64_t> ddim_timesteps(int64_t num_train_steps, const DdimOptions& options);

/// Predicts x_0 from (x_l, l).
using Denoiser = std::function<at::Tensor(const at::Tensor& x, int64_t timestep)>;
/// Called after each step with (steps done, steps in all).
using StepCallback = std::function<void(int64_t done, int64_t total)>;

/// @param noise x_{T_d}, any shape. @param generator for eta > 0. @returns the final estimate of
/// x_0.
at::Tensor ddim_sample(const Schedule& schedule, const Denoiser& denoiser, const at::Tensor& noise,
                       const DdimOptions& options, at::Generator generator,
                       const StepCallback& on_step = {});

}  // namespace freetalk::diffusion
