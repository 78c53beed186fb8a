#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cmath>

#include "freetalk/core/random.h"
#include "freetalk/diffusion/ddim.h"
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

TEST(Ddim, TrailingStartsAtTheNoisiestStep) {
  const auto timesteps = ddim_timesteps(1000, {100, 0.0, "trailing"});
  EXPECT_EQ(timesteps.front(), 999);
  EXPECT_EQ(timesteps.back(), 9);
  EXPECT_EQ(ddim_timesteps(1000, {100, 0.0, "leading"}).back(), 0);
  EXPECT_EQ(ddim_timesteps(1000, {100, 0.0, "linspace"}).back(), 0);
}

// For Gaussian data N(m, s^2) the best denoiser is known: samples must have that mean and
// deviation.
TEST(Ddim, RecoversAGaussian) {
  const Schedule schedule;
  const double mean = 3, deviation = 0.5;
  const Denoiser denoiser = [&](const at::Tensor& x, int64_t timestep) {
    const double a = schedule.alpha_bar(timestep);
    const double gain = std::sqrt(a) * deviation * deviation / (a * deviation * deviation + 1 - a);
    return mean + gain * (x - std::sqrt(a) * mean);
  };
  for (const double eta : {0.0, 1.0}) {
    const at::Tensor noise = torch::randn({20000}, core::make_generator(5));
    const at::Tensor sample =
        ddim_sample(schedule, denoiser, noise, {250, eta, "trailing"}, core::make_generator(6));
    EXPECT_NEAR(sample.mean().item<double>(), mean, 0.02);
    EXPECT_NEAR(sample.std().item<double>(), deviation,
                0.03);  // 250 of 1000 steps discretise the reverse process
  }
}

}  // namespace
}  // namespace freetalk::diffusion
