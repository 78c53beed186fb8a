#include <gtest/gtest.h>
#include <torch/torch.h>

#include "freetalk/ats/ats.h"
#include "freetalk/core/random.h"

namespace freetalk::ats {
namespace {

AtsOptions small_options() {
  AtsOptions options;
  options.d_model = 16;
  options.num_layers = 2;
  options.num_heads = 2;
  options.ff_dim = 32;
  options.audio_dim = 5;
  options.max_frames = 20;
  options.emotions = {"neutral", "happy", "afraid"};
  options.dropout = 0.0;
  return options;
}

Condition condition_for(int64_t batch, int64_t frames) {
  const auto generator = core::make_generator(1);
  at::Tensor emotion = torch::zeros({batch, 3});
  emotion.select(1, 1).fill_(1);
  return {torch::randn({batch, frames, 5}, generator),
          emotion,
          torch::full({batch}, 2.0),
          {},
          {},
          {},
          {},
          {}};
}

at::Tensor random_motion(int64_t batch, int64_t frames) {
  return torch::randn({batch, frames, kMotionDim}, core::make_generator(2));
}

AtsOptions untrained_options() {
  AtsOptions options = small_options();
  options.d_model = 64;
  options.max_frames = 40;
  options.norm_first = true;
  options.num_layers = 1;  // more would hand on what neighbouring frames have read
  return options;
}

TEST(Ats, FirstPositionShiftsBothTables) {
  torch::manual_seed(0);
  Ats model(small_options());
  model->eval();
  const torch::NoGradGuard no_grad;
  Condition condition = condition_for(2, 6);
  const at::Tensor x = random_motion(2, 6), step = torch::tensor({999, 3});
  const at::Tensor at_zero = model(x, step, condition);
  condition.first_position = torch::tensor({5, 0});
  const at::Tensor shifted = model(x, step, condition);
  EXPECT_TRUE(torch::allclose(shifted[1], at_zero[1], 1e-5, 1e-6));
  auto parameters = model->named_parameters();
  for (const char* name : {"target_positions", "memory_positions"}) {
    parameters[name].copy_(parameters[name].roll(-5, 0));
  }
  condition.first_position = at::Tensor();
  const at::Tensor rolled = model(x, step, condition);
  EXPECT_TRUE(torch::allclose(shifted[0], rolled[0], 1e-5, 1e-6));  // float32 rounding
  EXPECT_FALSE(torch::allclose(shifted[0], at_zero[0], 1e-3, 1e-3));
}

TEST(Ats, KnownFramesAreThoseOfTimestepZero) {
  torch::manual_seed(0);
  Ats model(small_options());
  model->eval();
  const torch::NoGradGuard no_grad;
  Condition condition = condition_for(2, 6);
  const at::Tensor x = random_motion(2, 6), step = torch::tensor({999, 999});
  const at::Tensor none = model(x, step, condition);
  const at::Tensor clean = model(x, torch::tensor({0, 0}), condition);
  condition.known = torch::tensor({0, 6});
  const at::Tensor some = model(x, step, condition);
  EXPECT_TRUE(torch::allclose(some[0], none[0], 1e-5, 1e-6));  // float32 rounding
  EXPECT_TRUE(torch::allclose(some[1], clean[1], 1e-5, 1e-6));
  EXPECT_FALSE(torch::allclose(none, clean, 1e-3, 1e-3));
  condition.known = torch::tensor({1, 2, 3});
  EXPECT_THROW(model(x, step, condition), std::invalid_argument);
}

// What frame 20 of the estimate owes to each frame of the speech, before any training.
TEST(Ats, StartsWithTheSpeechOfItsOwnFrame) {
  torch::manual_seed(0);
  AtsOptions options = untrained_options();
  const auto influence = [&](const std::string& start, int64_t band_radius) {
    options.attention_start = start;
    options.band_radius = band_radius;
    Ats model(options);
    model->eval();
    Condition condition = condition_for(1, 40);
    condition.audio.requires_grad_(true);
    const at::Tensor guess = model(random_motion(1, 40), torch::tensor({999}), condition);
    guess.select(1, 20).square().sum().backward();
    return condition.audio.grad().norm(2, {2}).squeeze(0);
  };
  const auto share_nearby = [](const at::Tensor& amount) {
    return (amount.narrow(0, 18, 5).sum() / amount.sum()).item<double>();
  };
  EXPECT_GT(share_nearby(influence("local", -1)), 0.5);
  EXPECT_LT(share_nearby(influence("random", -1)), 0.3);
  const at::Tensor banded = influence("local", 3);
  EXPECT_GT((banded[20] / banded[17]).item<double>(), 3.0);
  options.attention_start = "global";
  EXPECT_THROW(Ats{options}, std::invalid_argument);
}

// What frame 20 of the estimate owes to the noisy motion of other frames, before any training.
TEST(Ats, StartsWithTheMotionOfNeighbouringFrames) {
  torch::manual_seed(0);
  AtsOptions options = untrained_options();
  const auto share_nearby = [&](const std::string& start) {
    options.attention_start = start;
    Ats model(options);
    model->eval();
    const at::Tensor motion = random_motion(1, 40).requires_grad_(true);
    const at::Tensor guess = model(motion, torch::tensor({999}), condition_for(1, 40));
    guess.select(1, 20).square().sum().backward();
    at::Tensor amount = motion.grad().norm(2, {2}).squeeze(0);
    amount[20] = 0;
    return (amount.narrow(0, 16, 9).sum() / amount.sum()).item<double>();
  };
  EXPECT_GT(share_nearby("local"), 0.6);
  EXPECT_LT(share_nearby("random"), 0.4);
}

TEST(Ats, PaddingDoesNotReachValidFrames) {
  torch::manual_seed(0);
  Ats model(small_options());
  model->eval();
  Condition condition = condition_for(1, 12);
  condition.valid = torch::arange(12).lt(8).unsqueeze(0);
  const at::Tensor timestep = torch::tensor({500});
  at::Tensor x = random_motion(1, 12);
  const at::Tensor before = model(x, timestep, condition).narrow(1, 0, 8);
  x = x.clone();
  x.narrow(1, 8, 4).add_(10);
  condition.audio = condition.audio.clone();
  condition.audio.narrow(1, 8, 4).add_(10);
  const at::Tensor after = model(x, timestep, condition);
  EXPECT_TRUE(torch::allclose(before, after.narrow(1, 0, 8), 1e-5, 1e-5));
  EXPECT_TRUE(after.isfinite().all().item<bool>());

  Condition alone = condition;
  alone.audio = condition.audio.narrow(1, 0, 8);
  alone.valid = at::Tensor();
  EXPECT_TRUE(torch::allclose(before, model(x.narrow(1, 0, 8), timestep, alone), 1e-4, 1e-5));
}

TEST(Ats, AudioReachesOnlyTheBand) {
  torch::manual_seed(0);
  AtsOptions options = small_options();
  options.num_layers =
      1;  // self-attention comes before cross-attention: with one layer nothing spreads further
  options.band_radius = 2;
  Ats model(options);
  model->eval();
  Condition condition = condition_for(1, 12);
  const at::Tensor x = random_motion(1, 12), timestep = torch::tensor({10});
  const at::Tensor before = model(x, timestep, condition);
  condition.audio = condition.audio.clone();
  condition.audio.select(1, 6).add_(5);
  const at::Tensor change = (model(x, timestep, condition) - before).abs().amax(2).squeeze(0);
  for (int64_t frame = 0; frame < 12; ++frame) {
    EXPECT_EQ(change[frame].item<float>() > 1e-6F, std::abs(frame - 6) <= 2) << frame;
  }
}

TEST(Ats, IntensityInterpolatesBetweenLevels) {
  torch::manual_seed(0);
  Ats model(small_options());
  model->eval();
  const at::Tensor x = random_motion(1, 6), timestep = torch::tensor({10});
  Condition condition = condition_for(1, 6);
  const auto at_intensity = [&](double value) {
    condition.intensity = torch::full({1}, value);
    return model(x, timestep, condition);
  };
  EXPECT_TRUE(torch::allclose(at_intensity(2.0), at_intensity(2.0)));
  EXPECT_FALSE(torch::allclose(at_intensity(2.0), at_intensity(2.5)));
  EXPECT_FALSE(torch::allclose(at_intensity(2.5), at_intensity(3.0)));
}

TEST(Ats, MotionStatisticsInvertEachOther) {
  Ats model(small_options());
  model->set_motion_statistics(torch::full({kMotionDim}, 0.01), torch::full({kMotionDim}, 0.003));
  const at::Tensor motion = random_motion(1, 3);
  EXPECT_TRUE(torch::allclose(model->denormalize(model->normalize(motion)), motion, 1e-5, 1e-6));
  EXPECT_THROW(model->set_motion_statistics(torch::zeros({kMotionDim}), torch::zeros({kMotionDim})),
               std::invalid_argument);
}

TEST(Ats, WrongShapesAreNamed) {
  Ats model(small_options());
  EXPECT_THROW(model(torch::zeros({1, 4, 7}), torch::tensor({1}), condition_for(1, 4)),
               std::invalid_argument);
  EXPECT_THROW(model(random_motion(1, 21), torch::tensor({1}), condition_for(1, 21)),
               std::invalid_argument);
  EXPECT_THROW(model(random_motion(1, 4), torch::tensor({1}), condition_for(1, 5)),
               std::invalid_argument);
}

TEST(Ats, EmotionMayChangeOverTime) {
  torch::manual_seed(0);
  Ats model(small_options());
  model->eval();
  const at::Tensor x = random_motion(2, 6), timestep = torch::tensor({10, 400});
  Condition condition = condition_for(2, 6);
  const at::Tensor constant = model(x, timestep, condition);
  condition.emotion = condition.emotion.unsqueeze(1).expand({2, 6, 3});
  condition.intensity = condition.intensity.unsqueeze(1).expand({2, 6});
  EXPECT_TRUE(torch::allclose(model(x, timestep, condition), constant, 1e-5, 1e-6));
  condition.intensity = condition.intensity.clone();
  condition.intensity.select(1, 5).fill_(3);
  EXPECT_FALSE(torch::allclose(model(x, timestep, condition), constant, 1e-3, 1e-3));
  condition.intensity = torch::full({2}, 2.0);
  EXPECT_THROW(model(x, timestep, condition), std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::ats
