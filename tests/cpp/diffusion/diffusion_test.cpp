#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cmath>

#include "freetalk/core/random.h"
#include "freetalk/diffusion/sampler.h"
#include "freetalk/diffusion/schedule.h"

namespace freetalk::diffusion {
namespace {

TEST(Schedule, LinearAlphaBarIsTheProduct) {
  const Schedule schedule;
  double product = 1;
  for (int64_t step = 0; step < 1000; ++step) {
    product *= 1 - (1e-4 + (0.02 - 1e-4) * static_cast<double>(step) / 999);
    ASSERT_NEAR(schedule.alpha_bar(step), product, 1e-12);
  }
  EXPECT_EQ(schedule.alpha_bar(-1), 1.0);
}

TEST(Schedule, CosineFallsFromOneToZero) {
  ScheduleOptions options;
  options.kind = "cosine";
  const Schedule schedule(options);
  EXPECT_GT(schedule.alpha_bar(0), 0.99);
  EXPECT_LT(schedule.alpha_bar(999), 1e-3);
}

TEST(Schedule, QSampleMixesSignalAndNoise) {
  const Schedule schedule;
  const at::Tensor x0 = torch::ones({2, 3}), noise = torch::full({2, 3}, 2.0);
  const at::Tensor x = schedule.q_sample(x0, torch::tensor({0, 999}), noise);
  for (int i = 0; i < 2; ++i) {
    const double a = schedule.alpha_bar(i == 0 ? 0 : 999);
    EXPECT_NEAR(x[i][0].item<double>(), std::sqrt(a) + 2 * std::sqrt(1 - a), 1e-6);
  }
}

TEST(Schedule, BadOptionsThrow) {
  ScheduleOptions options;
  options.kind = "quadratic";
  EXPECT_THROW(Schedule{options}, std::invalid_argument);
}

/// The best denoiser of Gaussian data N(m, s^2), and what the reverse process does to it.
struct GaussianData {
  double mean = 3, deviation = 0.5;

  double spread(double a) const { return std::sqrt(a * deviation * deviation + 1 - a); }
  at::Tensor denoise(const at::Tensor& x, double a) const {
    const double gain = std::sqrt(a) * deviation * deviation / (spread(a) * spread(a));
    return mean + gain * (x - std::sqrt(a) * mean);
  }
  /// Exact solution of the probability flow from noise at a_first, denoised at a_last.
  at::Tensor exact(const at::Tensor& noise, double a_first, double a_last) const {
    const at::Tensor unit = (noise - std::sqrt(a_first) * mean) / spread(a_first);
    return denoise(std::sqrt(a_last) * mean + unit * spread(a_last), a_last);
  }
};

TEST(Sampler, TimestepsByName) {
  const Schedule schedule;
  const auto timesteps = [&](const char* spacing, const char* sampler = "ddim") {
    return sampler_timesteps(schedule, {sampler, 100, 0.0, spacing});
  };
  EXPECT_EQ(timesteps("trailing").front(), 999);
  EXPECT_EQ(timesteps("trailing").back(), 9);
  EXPECT_EQ(timesteps("leading").front(), 990);
  EXPECT_EQ(timesteps("leading").back(), 0);
  EXPECT_EQ(timesteps("linspace").front(), 999);
  EXPECT_EQ(timesteps("linspace").back(), 0);
  EXPECT_EQ(timesteps("auto"), timesteps("trailing"));
  EXPECT_EQ(timesteps("auto", "dpmpp"), timesteps("logsnr"));
}

TEST(Sampler, LogSnrTimestepsAreEvenInLambda) {
  for (const char* kind : {"linear", "cosine"}) {
    ScheduleOptions options;
    options.kind = kind;
    const Schedule schedule(options);
    const auto lambda = [&](int64_t t) {
      return 0.5 * std::log(schedule.alpha_bar(t) / (1 - schedule.alpha_bar(t)));
    };
    const auto timesteps = sampler_timesteps(schedule, {"dpmpp", 12, 0.0, "logsnr"});
    EXPECT_EQ(timesteps.front(), 999);
    EXPECT_EQ(timesteps.back(), 9);
    const double step = (lambda(9) - lambda(999)) / 11;
    for (size_t i = 1; i < timesteps.size(); ++i) {
      ASSERT_LT(timesteps[i], timesteps[i - 1]);
      // Whole timesteps: off by half of the distance between neighbours at either end.
      const double grain = lambda(timesteps[i] - 1) - lambda(timesteps[i] + 1);
      // The cosine schedule leaps at its noisy end, where several wanted ones fall on one timestep.
      const double share = std::round((lambda(timesteps[i]) - lambda(999)) / step);
      EXPECT_LE(std::abs(lambda(timesteps[i]) - lambda(999) - share * step), grain)
          << kind << " " << i;
    }
  }
}

TEST(Sampler, RecoversAGaussian) {
  const Schedule schedule;
  const GaussianData data;
  const Denoiser denoiser = [&](const at::Tensor& x, int64_t timestep) {
    return data.denoise(x, schedule.alpha_bar(timestep));
  };
  const at::Tensor noise = torch::randn({20000}, core::make_generator(5));
  for (const SamplerOptions& options :
       {SamplerOptions{"ddim", 250, 0.0}, SamplerOptions{"ddim", 250, 1.0},
        SamplerOptions{"ddpm", 250, 0.0}, SamplerOptions{"dpmpp", 20, 0.0}}) {
    const at::Tensor result = sample(schedule, denoiser, noise, options, core::make_generator(6));
    EXPECT_NEAR(result.mean().item<double>(), data.mean, 0.02) << options.sampler;
    // 250 of 1000 steps discretise the reverse process; the last estimate shrinks towards the mean.
    EXPECT_NEAR(result.std().item<double>(), data.deviation, 0.03) << options.sampler;
  }
}

TEST(Sampler, RenoiseNoisesTheEstimateAnew) {
  const Schedule schedule;
  const at::Tensor estimate = torch::tensor({0.5, -2.0}, torch::kDouble);
  std::vector<at::Tensor> seen;
  std::vector<int64_t> timesteps;
  const Denoiser denoiser = [&](const at::Tensor& x, int64_t timestep) {
    seen.push_back(x);
    timesteps.push_back(timestep);
    return estimate;
  };
  const NoiseSource ones = [](const at::Tensor& like) { return torch::ones_like(like); };
  const at::Tensor result =
      sample(schedule, denoiser, torch::zeros({2}, torch::kDouble), {"renoise", 4}, ones);
  EXPECT_TRUE(torch::equal(result, estimate));
  ASSERT_EQ(seen.size(), 4U);
  for (size_t i = 1; i < seen.size(); ++i) {
    const double a = schedule.alpha_bar(timesteps[i]);
    EXPECT_TRUE(torch::allclose(seen[i], std::sqrt(a) * estimate + std::sqrt(1 - a))) << i;
  }
}

TEST(Sampler, DdpmIsDdimWithEtaOne) {
  const Schedule schedule;
  const GaussianData data;
  const Denoiser denoiser = [&](const at::Tensor& x, int64_t timestep) {
    return data.denoise(x, schedule.alpha_bar(timestep));
  };
  const at::Tensor noise = torch::randn({100}, core::make_generator(5));
  const auto run = [&](const SamplerOptions& options) {
    return sample(schedule, denoiser, noise, options, core::make_generator(6));
  };
  // Two formulas of one process: equal up to the rounding of float32.
  EXPECT_TRUE(torch::allclose(run({"ddpm", 50, 0.0}), run({"ddim", 50, 1.0}), 1e-4, 1e-4));
}

TEST(Sampler, DpmSolverHasOrderTwo) {
  const Schedule schedule;
  const GaussianData data;
  const at::Tensor noise = torch::randn({200}, core::make_generator(5)).to(at::kDouble);
  const auto error = [&](const char* sampler, int64_t steps) {
    const SamplerOptions options{sampler, steps, 0.0, "logsnr"};
    const auto timesteps = sampler_timesteps(schedule, options);
    const Denoiser denoiser = [&](const at::Tensor& x, int64_t timestep) {
      return data.denoise(x, schedule.alpha_bar(timestep));
    };
    const at::Tensor exact = data.exact(noise, schedule.alpha_bar(timesteps.front()),
                                        schedule.alpha_bar(timesteps.back()));
    return (sample(schedule, denoiser, noise, options, core::make_generator(6)) - exact)
        .abs()
        .max()
        .item<double>();
  };
  // Twice the steps: a quarter of the error; half of it with DDIM, which is the solver of order
  // one.
  EXPECT_GT(error("dpmpp", 20) / error("dpmpp", 40), 3.0);
  EXPECT_LT(error("ddim", 20) / error("ddim", 40), 2.5);
  EXPECT_LT(error("dpmpp", 20), 0.2 * error("ddim", 20));
}

TEST(Sampler, BadOptionsAreNamed) {
  const Schedule schedule;
  const auto message = [&](const SamplerOptions& options) -> std::string {
    try {
      sampler_timesteps(schedule, options);
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_NE(message({"euler"}).find("dpmpp"), std::string::npos);
  EXPECT_NE(message({"ddim", 0}).find("num_steps"), std::string::npos);
  EXPECT_NE(message({"ddim", 1001}).find("1000"), std::string::npos);
  EXPECT_NE(message({"ddim", 10, 1.5}).find("eta"), std::string::npos);
  EXPECT_NE(message({"dpmpp", 10, 0.5}).find("eta"), std::string::npos);
  EXPECT_NE(message({"ddim", 10, 0.0, "random"}).find("logsnr"), std::string::npos);
}

}  // namespace
}  // namespace freetalk::diffusion
