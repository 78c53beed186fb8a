// Noise schedules and the forward process of denoising diffusion [Ho et al. 2020; FreeTalk Eq.
// 4-5].
#pragma once

#include <ATen/core/Tensor.h>

#include <string>

namespace freetalk::diffusion {

struct ScheduleOptions {
  std::string kind = "linear";  // "linear" (Ho et al. 2020) or "cosine" (Nichol & Dhariwal 2021)
  int64_t num_steps = 1000;     // T_d
  double beta_start = 1e-4;     // linear only
  double beta_end = 0.02;       // linear only
  template <class V>
  void fields(V& v) {
    v("kind", kind);
    v("num_steps", num_steps);
    v("beta_start", beta_start);
    v("beta_end", beta_end);
  }
  void check() const;
};

class Schedule {
 public:
  explicit Schedule(const ScheduleOptions& options = {});

  /// x_l = sqrt(alpha_bar_l) x_0 + sqrt(1 - alpha_bar_l) eps [FreeTalk Eq. 5].
  /// @param x0 (B, ...). @param timestep (B,) int64 in [0, num_steps). @param noise as x0.
  at::Tensor q_sample(const at::Tensor& x0, const at::Tensor& timestep,
                      const at::Tensor& noise) const;

  /// alpha_bar at a timestep; 1 at -1 (the clean end).
  double alpha_bar(int64_t timestep) const;
  /// (num_steps,) float64 on the CPU.
  const at::Tensor& alphas_cumprod() const { return alphas_cumprod_; }
  const ScheduleOptions& options() const { return options_; }

 private:
  ScheduleOptions options_;
  at::Tensor alphas_cumprod_;
};

}  // namespace freetalk::diffusion
