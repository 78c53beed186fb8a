#include <gtest/gtest.h>
#include <torch/torch.h>

#include "freetalk/ats/ats.h"
#include "freetalk/ats/generate.h"
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
  return {
      torch::randn({batch, frames, 5}, generator), emotion, torch::full({batch}, 2.0), {}, {}, {}};
}

at::Tensor random_motion(int64_t batch, int64_t frames) {
  return torch::randn({batch, frames, kMotionDim}, core::make_generator(2));
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

TEST(WindowStarts, CoverAndOverlap) {
  for (const int64_t frames : {1, 20, 21, 50, 133}) {
    const auto starts = window_starts(frames, 20, 6);
    EXPECT_EQ(starts.front(), 0);
    for (size_t i = 1; i < starts.size(); ++i) EXPECT_LE(starts[i], starts[i - 1] + 20 - 6);
    EXPECT_GE(starts.back() + 20, frames);
    EXPECT_EQ(starts.back() + std::min<int64_t>(frames, 20), frames);
  }
}

TEST(Generate, SameSeedSameMotionAnyLength) {
  torch::manual_seed(0);
  Ats model(small_options());
  model->eval();
  GenerateOptions options;
  options.num_steps = 4;
  options.window_overlap = 6;
  const at::Tensor emotion = parse_emotion("happy", model->options().emotions);
  for (const int64_t frames : {1, 20, 57}) {
    const at::Tensor features = torch::randn({frames, 5}, core::make_generator(3));
    const auto run = [&](uint64_t seed) {
      return generate(model, features, emotion, 2.0, options, core::make_generator(seed));
    };
    EXPECT_EQ(run(1).sizes(), (std::vector<int64_t>{frames, 68, 3}));
    EXPECT_TRUE(torch::equal(run(1), run(1)));
    EXPECT_FALSE(torch::equal(run(1), run(2)));
  }
}

TEST(Generate, WindowBatchingDoesNotChangeTheResult) {
  torch::manual_seed(0);
  Ats model(small_options());
  model->eval();
  GenerateOptions options;
  options.num_steps = 3;
  options.window_overlap = 6;
  const at::Tensor emotion = parse_emotion("neutral", model->options().emotions);
  const at::Tensor features = torch::randn({75, 5}, core::make_generator(3));
  options.windows_per_batch = 1;
  const at::Tensor one = generate(model, features, emotion, 1.0, options, core::make_generator(1));
  options.windows_per_batch = 8;
  const at::Tensor many = generate(model, features, emotion, 1.0, options, core::make_generator(1));
  EXPECT_TRUE(torch::allclose(one, many, 1e-4, 1e-5));
}

TEST(Generate, IntensityOutOfRangeThrows) {
  Ats model(small_options());
  const at::Tensor emotion = parse_emotion("happy", model->options().emotions);
  EXPECT_THROW(generate(model, torch::zeros({4, 5}), emotion, 3.5, {}, core::make_generator(0)),
               std::invalid_argument);
}

TEST(ParseEmotion, NamesAliasesAndMixtures) {
  const std::vector<std::string> emotions = {"neutral", "happy", "afraid"};
  EXPECT_TRUE(torch::allclose(parse_emotion("fear", emotions), torch::tensor({0.0F, 0.0F, 1.0F})));
  EXPECT_TRUE(torch::allclose(parse_emotion("happy:3,neutral:1", emotions),
                              torch::tensor({0.25F, 0.75F, 0.0F})));
  for (const char* bad : {"hungry", "happy:", "happy:-1", "happy:0", "", "happy:x"}) {
    EXPECT_THROW(parse_emotion(bad, emotions), std::invalid_argument) << bad;
  }
  try {
    parse_emotion("hungry", emotions);
  } catch (const std::invalid_argument& error) {
    EXPECT_NE(std::string(error.what()).find("neutral, happy, afraid"), std::string::npos);
  }
}

}  // namespace
}  // namespace freetalk::ats
