#include "freetalk/ats/motion_stream.h"

#include <gtest/gtest.h>
#include <torch/torch.h>

#include "freetalk/core/random.h"
#include "freetalk/diffusion/sampler.h"

namespace freetalk::ats {
namespace {

constexpr int64_t kChannels = 5;

Ats stream_model(bool known_prefix = false) {
  AtsOptions options;
  options.d_model = 16;
  options.num_layers = 2;
  options.num_heads = 2;
  options.ff_dim = 32;
  options.audio_dim = kChannels;
  options.max_frames = 40;
  options.emotions = {"neutral", "happy"};
  options.known_prefix = known_prefix;
  torch::manual_seed(0);
  Ats model(options);
  model->eval();
  return model;
}

at::Tensor stream_features(int64_t frames) {
  return torch::randn({frames, kChannels}, core::make_generator(3));
}

std::vector<EmotionKey> happy() { return {{0.0, torch::tensor({0.0F, 1.0F}), 2.0}}; }

TEST(MotionStream, AStreamOfOneWindowIsGenerate) {
  Ats model = stream_model();
  MotionStreamOptions options;
  options.window_frames = 40;
  options.redo_frames = 0;
  options.generate.mouth_temperature = 0.5;
  options.generate.articulation = 1.3;
  MotionStream stream(model, happy(), 7, options);
  const at::Tensor features = stream_features(16);
  const at::Tensor motion = stream.finish(features);
  const at::Tensor whole =
      generate(model, features, happy()[0].emotion, 2.0, options.generate, core::make_generator(7));
  // Weights are laid out for another number of rows: other rounding.
  EXPECT_TRUE(at::allclose(motion, whole, 1e-4, 1e-5));
  EXPECT_TRUE(at::equal(stream.finish(features), motion));  // it started afresh
  options.generate.articulation = 1;
  const at::Tensor plain =
      generate(model, features, happy()[0].emotion, 2.0, options.generate, core::make_generator(7));
  EXPECT_TRUE(at::equal(whole, articulate(plain, 1.3)));
}

TEST(MotionStream, ShowsEveryFrameOnceAndKeepsTheLastBack) {
  MotionStreamOptions options;
  options.window_frames = 20;
  MotionStream stream(stream_model(), happy(), 7, options);
  const at::Tensor features = stream_features(61);
  int64_t shown = 0, heard = 0;
  for (const int64_t count : {1, 2, 0, 6, 30, 5}) {
    const at::Tensor made = stream.push(features.narrow(0, heard, count));
    shown += made.size(0);
    heard += count;
    EXPECT_EQ(shown, std::max<int64_t>(0, heard - options.redo_frames));
    EXPECT_TRUE(made.isfinite().all().item<bool>());
  }
  EXPECT_EQ(stream.finish(features.narrow(0, heard, 61 - heard)).size(0), 61 - shown);
}

TEST(MotionStream, AModelThatKnowsPrefixesSeesWhatWasShown) {
  for (const bool known_prefix : {true, false}) {
    Ats model = stream_model(known_prefix);
    MotionStreamOptions options;
    options.window_frames = 40;
    options.redo_frames = 0;
    MotionStream stream(model, happy(), 7, options);
    const at::Tensor features = stream_features(20);
    const at::Tensor first = stream.push(features.narrow(0, 0, 12));
    const at::Tensor then = stream.push(features.narrow(0, 12, 8));
    // The same by hand: the shown frames stay clean at every step.
    const diffusion::Schedule schedule(model->options().schedule_options());
    const auto sampling = options.generate.sampler_options();
    const at::Tensor shown = model->normalize(first.flatten(1)).unsqueeze(0);
    const at::Tensor noise = torch::randn({20, kMotionDim}, core::make_generator(7)).unsqueeze(0);
    Condition condition{features.unsqueeze(0),
                        happy()[0].emotion.unsqueeze(0),
                        torch::tensor({2.0F}),
                        {},
                        {},
                        {},
                        {},
                        {}};
    condition.known = torch::tensor({12});
    const torch::NoGradGuard no_grad;
    const auto denoise = [&](const at::Tensor& x, int64_t timestep) {
      const at::Tensor given = at::cat({shown, x.slice(1, 12)}, 1);
      return at::cat({shown, model(given, torch::tensor({timestep}), condition).slice(1, 12)}, 1);
    };
    const auto none = [](const at::Tensor& like) { return at::zeros_like(like); };
    const at::Tensor x0 = diffusion::sample(schedule, denoise, noise, sampling, none);
    const at::Tensor expected = model->denormalize(x0[0].slice(0, 12)).unflatten(1, {68, 3});
    EXPECT_EQ(torch::allclose(then, expected, 1e-3, 1e-4), known_prefix)
        << (then - expected).abs().max().item<float>();
  }
}

TEST(MotionStream, RejectsWhatItCannotDo) {
  const auto rejected = [](auto change) {
    MotionStreamOptions options;
    options.window_frames = 20;
    change(options);
    EXPECT_THROW(MotionStream(stream_model(), happy(), 0, options), std::invalid_argument);
  };
  rejected([](MotionStreamOptions& o) { o.generate.sampler = "ddpm"; });
  rejected([](MotionStreamOptions& o) {
    o.generate.sampler = "ddim";
    o.generate.eta = 0.5;
  });
  rejected([](MotionStreamOptions& o) { o.window_frames = 41; });
  rejected([](MotionStreamOptions& o) { o.redo_frames = 10; });
  rejected([](MotionStreamOptions& o) { o.emotion_ramp_s = 0; });
  MotionStream stream(stream_model(), happy(), 0, {.window_frames = 20});
  EXPECT_THROW(stream.push(torch::zeros({3, kChannels + 1})), std::invalid_argument);
  // Without data: torch's own error, as the documented type.
  EXPECT_THROW(stream.push(torch::zeros({3, kChannels}, torch::kMeta)), std::runtime_error);
}

}  // namespace
}  // namespace freetalk::ats
