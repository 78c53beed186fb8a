// Samplers of the reverse process, by name, for a denoiser that predicts x_0. With a = alpha_bar,
// l the timestep, p the next one (a_p = 1 at the clean end) and eps = (x_l - sqrt(a_l) x0) /
// sqrt(1 - a_l):
//
//   "ddim"   x_p = sqrt(a_p) x0 + sqrt(1 - a_p - s^2) eps + s z,
//            s = eta sqrt((1 - a_p) / (1 - a_l)) sqrt(1 - a_l / a_p)        [Song et al. 2021, Eq.
//            12]
//   "ddpm"   x_p = (sqrt(a_p) (1 - b) x0 + sqrt(b) (1 - a_p) x_l) / (1 - a_l) + s z,
//            b = a_l / a_p, s^2 = (1 - b) (1 - a_p) / (1 - a_l)       [Ho et al. 2020, Eq. 7,
//            respaced]
//   "renoise" x_p = sqrt(a_p) x0 + sqrt(1 - a_p) z: "ddim" with s^2 = 1 - a_p, the estimate is
//            noised anew [FaceTalk Eq. 9]
//   "dpmpp"  DPM-Solver++(2M): with lambda = log(sqrt(a) / sqrt(1 - a)), h = lambda_p - lambda_l,
//            q = (lambda_l - lambda_before) / h, D = (1 + 1 / (2 q)) x0 - 1 / (2 q) x0_before,
//            x_p = sqrt((1 - a_p) / (1 - a_l)) x_l - sqrt(a_p) (e^-h - 1) D
//            [Lu et al. 2022, Alg. 2]; the first and the last step have order one.
//
// All of them end with the denoiser's last estimate of x_0.
#pragma once

#include <ATen/core/Generator.h>
#include <ATen/core/Tensor.h>

#include <functional>
#include <string>
#include <vector>

#include "freetalk/diffusion/schedule.h"

namespace freetalk::diffusion {

struct SamplerOptions {
  std::string sampler = "ddim";  // "ddim", "ddpm", "renoise" or "dpmpp"
  int64_t num_steps = 100;       // N, reverse steps, 1 .. T_d; "dpmpp" needs 10 to 20
  double eta = 0.0;              // "ddim" only. 0: deterministic; 1: as noisy as "ddpm"
  /// "trailing": from T_d - 1 in steps of T_d / N; "leading": the same ending at 0; "linspace":
  /// evenly from T_d - 1 to 0; "logsnr": evenly in lambda from T_d - 1 to T_d / 100 - 1, where 100
  /// trailing steps end; "auto": "logsnr" for "dpmpp", else "trailing".
  std::string spacing = "auto";
  template <class V>
  void fields(V& v) {
    v("sampler", sampler);
    v("num_steps", num_steps);
    v("eta", eta);
    v("spacing", spacing);
  }
  void check() const;
};

/// The timesteps visited, strictly falling. "logsnr" visits fewer than num_steps where neighbours
/// would fall on the same timestep.
/// @throws std::invalid_argument if num_steps exceeds the schedule's.
std::vector<int64_t> sampler_timesteps(const Schedule& schedule, const SamplerOptions& options);

/// Predicts x_0 from (x_l, l).
using Denoiser = std::function<at::Tensor(const at::Tensor& x, int64_t timestep)>;
/// Standard normal noise shaped as its argument.
using NoiseSource = std::function<at::Tensor(const at::Tensor& like)>;
/// Called after each step with (steps done, steps in all).
using StepCallback = std::function<void(int64_t done, int64_t total)>;

/// @param noise x_{T_d}, any shape. @param draw the z of the stochastic samplers, once a step that
/// needs it. @returns the final estimate of x_0.
at::Tensor sample(const Schedule& schedule, const Denoiser& denoiser, const at::Tensor& noise,
                  const SamplerOptions& options, const NoiseSource& draw,
                  const StepCallback& on_step = {});

/// The same with z from a generator.
at::Tensor sample(const Schedule& schedule, const Denoiser& denoiser, const at::Tensor& noise,
                  const SamplerOptions& options, at::Generator generator,
                  const StepCallback& on_step = {});

}  // namespace freetalk::diffusion
