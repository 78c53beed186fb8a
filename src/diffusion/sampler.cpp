#include "freetalk/diffusion/sampler.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include "freetalk/core/error.h"

namespace freetalk::diffusion {
namespace {

double half_log_snr(double alpha_bar) { return 0.5 * std::log(alpha_bar / (1 - alpha_bar)); }

/// Evenly in lambda; timesteps are whole numbers, so neighbours that coincide count once.
std::vector<int64_t> log_snr_timesteps(const Schedule& schedule, int64_t count) {
  const int64_t total = schedule.options().num_steps;
  const int64_t last = std::max<int64_t>(0, total / 100 - 1);
  const double from = half_log_snr(schedule.alpha_bar(total - 1));
  const double to = half_log_snr(schedule.alpha_bar(last));
  std::vector<int64_t> timesteps;
  int64_t timestep = total - 1;
  for (int64_t i = 0; i < count; ++i) {
    const double share = count > 1 ? static_cast<double>(i) / static_cast<double>(count - 1) : 0;
    const double wanted = from + share * (to - from);
    const auto distance = [&](int64_t t) {
      return std::abs(half_log_snr(schedule.alpha_bar(t)) - wanted);
    };
    while (timestep > last && distance(timestep - 1) <= distance(timestep)) --timestep;
    if (timesteps.empty() || timestep < timesteps.back()) timesteps.push_back(timestep);
  }
  return timesteps;
}

/// What one step knows: signal and noise levels here and after it.
struct Step {
  double a, a_next;  // alpha_bar
};

/// One reverse step of a sampler.
class Stepper {
 public:
  virtual ~Stepper() = default;
  virtual at::Tensor next(const at::Tensor& x, const at::Tensor& x0, const Step& step) = 0;
};

class DdimStepper : public Stepper {
 public:
  DdimStepper(double eta, const NoiseSource& draw) : eta_(eta), draw_(draw) {}

  at::Tensor next(const at::Tensor& x, const at::Tensor& x0, const Step& step) override {
    const auto [a, a_next] = step;
    const double sigma = eta_ * std::sqrt((1 - a_next) / (1 - a)) * std::sqrt(1 - a / a_next);
    const double direction = std::sqrt(std::max(0.0, 1 - a_next - sigma * sigma) / (1 - a));
    const at::Tensor result = (std::sqrt(a_next) - direction * std::sqrt(a)) * x0 + direction * x;
    return sigma > 0 ? result + sigma * draw_(x) : result;
  }

 private:
  double eta_;
  const NoiseSource& draw_;
};

class DdpmStepper : public Stepper {
 public:
  explicit DdpmStepper(const NoiseSource& draw) : draw_(draw) {}

  at::Tensor next(const at::Tensor& x, const at::Tensor& x0, const Step& step) override {
    const auto [a, a_next] = step;
    const double kept = a / a_next;
    const double variance = (1 - kept) * (1 - a_next) / (1 - a);
    const at::Tensor mean = (std::sqrt(a_next) * (1 - kept) / (1 - a)) * x0 +
                            (std::sqrt(kept) * (1 - a_next) / (1 - a)) * x;
    return variance > 0 ? mean + std::sqrt(variance) * draw_(x) : mean;
  }

 private:
  const NoiseSource& draw_;
};

class RenoiseStepper : public Stepper {
 public:
  explicit RenoiseStepper(const NoiseSource& draw) : draw_(draw) {}

  at::Tensor next(const at::Tensor& x, const at::Tensor& x0, const Step& step) override {
    return std::sqrt(step.a_next) * x0 + std::sqrt(1 - step.a_next) * draw_(x);
  }

 private:
  const NoiseSource& draw_;
};

class DpmSolverStepper : public Stepper {
 public:
  at::Tensor next(const at::Tensor& x, const at::Tensor& x0, const Step& step) override {
    const auto [a, a_next] = step;
    const double h = half_log_snr(a_next) - half_log_snr(a);
    at::Tensor slope = x0;
    if (x0_before_.defined()) {
      const double weight = h / (2 * h_before_);
      slope = (1 + weight) * x0 - weight * x0_before_;
    }
    x0_before_ = x0;
    h_before_ = h;
    return std::sqrt((1 - a_next) / (1 - a)) * x - std::sqrt(a_next) * std::expm1(-h) * slope;
  }

 private:
  at::Tensor x0_before_;
  double h_before_ = 0;
};

std::unique_ptr<Stepper> make_stepper(const SamplerOptions& options, const NoiseSource& draw) {
  if (options.sampler == "ddpm") return std::make_unique<DdpmStepper>(draw);
  if (options.sampler == "renoise") return std::make_unique<RenoiseStepper>(draw);
  if (options.sampler == "dpmpp") return std::make_unique<DpmSolverStepper>();
  return std::make_unique<DdimStepper>(options.eta, draw);
}

}  // namespace

void SamplerOptions::check() const {
  FREETALK_CHECK(
      sampler == "ddim" || sampler == "ddpm" || sampler == "renoise" || sampler == "dpmpp",
      "sampler must be ddim, ddpm, renoise or dpmpp, found '", sampler, "'");
  FREETALK_CHECK(num_steps > 0, "num_steps must be positive, found ", num_steps);
  FREETALK_CHECK(eta >= 0 && eta <= 1, "eta must be in [0, 1], found ", eta);
  FREETALK_CHECK(eta == 0 || sampler == "ddim", "eta is an option of ddim, but the sampler is ",
                 sampler, "; leave it at 0");
  FREETALK_CHECK(spacing == "auto" || spacing == "trailing" || spacing == "leading" ||
                     spacing == "linspace" || spacing == "logsnr",
                 "spacing must be auto, trailing, leading, linspace or logsnr, found '", spacing,
                 "'");
}

std::vector<int64_t> sampler_timesteps(const Schedule& schedule, const SamplerOptions& options) {
  options.check();
  const int64_t count = options.num_steps, total = schedule.options().num_steps;
  FREETALK_CHECK(count <= total, "num_steps (", count, ") exceeds the ", total,
                 " steps of the noise schedule");
  std::string spacing = options.spacing;
  if (spacing == "auto") spacing = options.sampler == "dpmpp" ? "logsnr" : "trailing";
  if (spacing == "logsnr") return log_snr_timesteps(schedule, count);
  std::vector<int64_t> timesteps;
  for (int64_t left = count; left > 0; --left) {
    if (spacing == "trailing") {
      const double share = static_cast<double>(left) / static_cast<double>(count);
      timesteps.push_back(std::lround(share * static_cast<double>(total)) - 1);
    } else if (spacing == "leading") {
      timesteps.push_back((left - 1) * (total / count));
    } else {
      const double share =
          count > 1 ? static_cast<double>(left - 1) / static_cast<double>(count - 1) : 1.0;
      timesteps.push_back(std::lround(share * static_cast<double>(total - 1)));
    }
  }
  return timesteps;
}

at::Tensor sample(const Schedule& schedule, const Denoiser& denoiser, const at::Tensor& noise,
                  const SamplerOptions& options, const NoiseSource& draw,
                  const StepCallback& on_step) {
  const auto timesteps = sampler_timesteps(schedule, options);
  const auto stepper = make_stepper(options, draw);
  at::Tensor x = noise, x0;
  for (size_t i = 0; i < timesteps.size(); ++i) {
    const bool last = i + 1 == timesteps.size();
    x0 = denoiser(x, timesteps[i]);
    if (!last) {
      x = stepper->next(x, x0,
                        {schedule.alpha_bar(timesteps[i]), schedule.alpha_bar(timesteps[i + 1])});
    }
    if (on_step) on_step(static_cast<int64_t>(i) + 1, static_cast<int64_t>(timesteps.size()));
  }
  return x0;
}

at::Tensor sample(const Schedule& schedule, const Denoiser& denoiser, const at::Tensor& noise,
                  const SamplerOptions& options, at::Generator generator,
                  const StepCallback& on_step) {
  const NoiseSource draw = [&generator](const at::Tensor& like) {
    return at::randn(like.sizes(), generator, like.options());
  };
  return sample(schedule, denoiser, noise, options, draw, on_step);
}

}  // namespace freetalk::diffusion
