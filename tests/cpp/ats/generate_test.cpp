#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cmath>
#include <vector>

#include "ats/inference.h"
#include "freetalk/ats/generate.h"
#include "freetalk/core/random.h"

namespace freetalk::ats {
namespace {

AtsOptions sampling_options() {
  AtsOptions options;
  options.d_model = 16;
  options.num_layers = 2;
  options.num_heads = 2;
  options.ff_dim = 32;
  options.audio_dim = 5;
  options.max_frames = 20;
  options.emotions = {"neutral", "happy", "afraid"};
  options.dropout = 0.1;
  return options;
}

Ats make_model(const AtsOptions& options) {
  torch::manual_seed(0);
  Ats model(options);
  const torch::NoGradGuard no_grad;
  for (at::Tensor& parameter : model->parameters())
    parameter.add_(torch::randn_like(parameter) * 0.05);
  model->eval();
  return model;
}

at::Tensor features_of(int64_t frames) {
  return torch::randn({frames, 5}, core::make_generator(3));
}

std::vector<at::Generator> generators(const std::vector<uint64_t>& seeds) {
  std::vector<at::Generator> result;
  for (const uint64_t seed : seeds) result.push_back(core::make_generator(seed));
  return result;
}

Affect changing_affect(int64_t frames) {
  const at::Tensor share = torch::linspace(0, 1, frames).unsqueeze(1);
  return {torch::eye(3).narrow(0, 0, 2), torch::tensor({1.0F, 3.0F}),
          torch::cat({1 - share, share}, 1)};
}

TEST(AtsInference, EqualsForward) {
  for (const bool norm_first : {false, true}) {
    for (const auto& [radius, frames] : std::vector<std::pair<int64_t, int64_t>>{
             {3, 16}, {3, 37}, {0, 17}, {2, 1}, {9, 5}, {-1, 20}}) {
      AtsOptions options = sampling_options();
      options.max_frames = 40;
      options.norm_first = norm_first;
      options.activation = norm_first ? "relu" : "gelu";
      options.band_radius = radius;
      Ats model = make_model(options);
      const torch::NoGradGuard no_grad;
      const auto draw = core::make_generator(4);
      const at::Tensor audio = torch::randn({2, frames, 5}, draw);
      const Affect felt = changing_affect(frames);
      const at::Tensor x = torch::randn({3, 2, frames, kMotionDim}, draw);
      AtsInference network(*model, {999, 40}, at::kFloat, 2 * frames);
      const int64_t known = frames / 3;
      const auto prepared = network.prepare(audio, felt, /*null_audio=*/true, known);
      const at::Tensor guesses =
          network.denoise(x, 40, prepared, {{false, 1}, {true, 0}, {false, 2}});
      for (int64_t variant = 0; variant < 3; ++variant) {
        const int64_t key = variant == 0 ? 1 : 0;
        Condition condition{
            audio, felt.emotion[key].expand({2, -1}), felt.intensity[key].expand({2}), {}, {}, {},
            {},    torch::full({2}, known, at::kLong)};
        const at::Tensor dropped = torch::ones({2}, at::kBool);
        if (variant == 1) condition.drop_audio = dropped;
        if (variant == 2) condition.drop_affect = dropped;
        const at::Tensor expected = model(x[variant], torch::tensor({40, 40}), condition);
        // Other kernels and other summation orders of float32, through two layers.
        EXPECT_TRUE(torch::allclose(guesses[variant], expected, 1e-4, 2e-5))
            << "radius " << radius << ", frames " << frames << ", variant " << variant << ": "
            << (guesses[variant] - expected).abs().max().item<float>();
      }
    }
  }
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
  Ats model = make_model(sampling_options());
  GenerateOptions options;
  options.num_steps = 4;
  options.window_overlap = 6;
  options.windows_per_batch = 2;
  const at::Tensor emotion = parse_emotion("happy", model->options().emotions);
  for (const int64_t frames : {1, 20, 57, 120}) {
    const at::Tensor features = features_of(frames);
    const auto run = [&](uint64_t seed) {
      return generate(model, features, emotion, 2.0, options, core::make_generator(seed));
    };
    EXPECT_EQ(run(1).sizes(), (std::vector<int64_t>{frames, 68, 3}));
    EXPECT_TRUE(torch::equal(run(1), run(1)));
    EXPECT_FALSE(torch::equal(run(1), run(2)));
  }
}

TEST(Generate, UsesNoPositionBeyondTheTrainedFrames) {
  AtsOptions options = sampling_options();
  options.trained_frames = 8;
  Ats model = make_model(options);
  const at::Tensor features = features_of(30), emotion = torch::eye(3)[1];
  const GenerateOptions sampling{.num_steps = 3, .window_overlap = 2};
  const auto motion = [&] {
    return generate(model, features, emotion, 2.0, sampling, core::make_generator(5));
  };
  const at::Tensor before = motion();
  const torch::NoGradGuard no_grad;
  auto parameters = model->named_parameters();
  for (const char* name : {"target_positions", "memory_positions"}) {
    parameters[name].narrow(0, 8, 12).fill_(100.0);
  }
  EXPECT_TRUE(torch::equal(motion(), before));
}

// The whole of it, written out over the layers that training uses.
TEST(Generate, IsGuidedDiffusionOverTheModel) {
  Ats model = make_model(sampling_options());
  const torch::NoGradGuard no_grad;
  GenerateOptions options;
  options.num_steps = 10;
  options.audio_guidance = 1.5;
  options.affect_guidance = 2.5;
  const int64_t frames = 18;
  const at::Tensor features = features_of(frames);
  const Affect felt = changing_affect(frames);
  const diffusion::Schedule schedule(model->options().schedule_options());
  const at::Tensor dropped = torch::ones({1}, at::kBool);
  const auto denoiser = [&](const at::Tensor& x, int64_t timestep) {
    const at::Tensor step = torch::full({1}, timestep, at::kLong);
    const auto blended = [&](bool drop_audio, bool drop_affect) {
      at::Tensor sum = torch::zeros_like(x);
      for (int64_t key = 0; key < 2; ++key) {
        Condition condition{features.unsqueeze(0),
                            felt.emotion[key].unsqueeze(0),
                            felt.intensity[key].unsqueeze(0),
                            {},
                            drop_audio ? dropped : at::Tensor(),
                            drop_affect ? dropped : at::Tensor(),
                            {},
                            {}};
        sum = sum + model(x, step, condition) * felt.weight.select(1, key).view({1, -1, 1});
      }
      return sum;
    };
    const at::Tensor full = blended(false, false);
    return full + 0.5 * (full - blended(true, false)) + 1.5 * (full - blended(false, true));
  };
  const at::Tensor noise = torch::randn({frames, kMotionDim}, core::make_generator(8)).unsqueeze(0);
  const at::Tensor expected = diffusion::sample(schedule, denoiser, noise,
                                                options.sampler_options(), core::make_generator(0));
  const at::Tensor motion = generate(model, features, felt, options, generators({8}));
  // Guidance amplifies the rounding of ten steps.
  EXPECT_TRUE(torch::allclose(motion.flatten(2), expected, 1e-3, 1e-4));
}

TEST(Generate, SamplesTogetherEqualSamplesAlone) {
  Ats model = make_model(sampling_options());
  const at::Tensor features = features_of(75);
  const Affect felt = changing_affect(75);
  for (const char* sampler : {"ddim", "ddpm", "dpmpp"}) {
    GenerateOptions options;
    options.sampler = sampler;
    options.num_steps = 5;
    options.window_overlap = 6;
    options.windows_per_batch = 3;
    options.audio_guidance = 1.5;
    const at::Tensor together = generate(model, features, felt, options, generators({1, 2, 3}));
    EXPECT_EQ(together.sizes(), (std::vector<int64_t>{3, 75, 68, 3}));
    for (int64_t k = 0; k < 3; ++k) {
      const at::Tensor alone =
          generate(model, features, felt, options, generators({static_cast<uint64_t>(k) + 1}))[0];
      EXPECT_TRUE(torch::allclose(together[k], alone, 1e-3, 1e-4)) << sampler << " " << k;
    }
  }
}

// What a group has finished does not depend on what follows, so motion can be made piece by piece.
TEST(Generate, AFinishedGroupIgnoresWhatFollows) {
  Ats model = make_model(sampling_options());
  GenerateOptions options;
  options.num_steps = 4;
  options.eta = 1.0;
  options.window_overlap = 5;
  options.windows_per_batch = 2;
  const Affect felt = constant_affect(parse_emotion("happy", model->options().emotions), 2.0);
  at::Tensor features = features_of(95);  // 6 windows of 20, each 15 after the one before
  const at::Tensor before = generate(model, features, felt, options, generators({1}))[0];
  features = features.clone();
  features.narrow(0, 40, 55).add_(3);
  const at::Tensor after = generate(model, features, felt, options, generators({1}))[0];
  EXPECT_TRUE(torch::equal(before.narrow(0, 0, 30), after.narrow(0, 0, 30)));  // 5 are shared
  EXPECT_FALSE(torch::equal(before.narrow(0, 35, 60), after.narrow(0, 35, 60)));
}

TEST(Generate, BFloat16IsClose) {
  Ats model = make_model(sampling_options());
  GenerateOptions options;
  options.num_steps = 10;
  const Affect felt = constant_affect(parse_emotion("happy", model->options().emotions), 2.0);
  const at::Tensor features = features_of(20);
  const at::Tensor exact = generate(model, features, felt, options, generators({1}));
  options.precision = "bfloat16";
  const at::Tensor coarse = generate(model, features, felt, options, generators({1}));
  EXPECT_EQ(coarse.scalar_type(), at::kFloat);
  // Eight bits of mantissa: 0.4 % a product.
  EXPECT_LT(((coarse - exact).norm() / exact.norm()).item<double>(), 0.03);
  EXPECT_GT((coarse - exact).abs().max().item<double>(), 0.0);
}

TEST(Generate, WrongInputsThrow) {
  Ats model = make_model(sampling_options());
  const at::Tensor emotion = parse_emotion("happy", model->options().emotions);
  const at::Tensor features = torch::zeros({4, 5});
  EXPECT_THROW(generate(model, features, emotion, 3.5, {}, core::make_generator(0)),
               std::invalid_argument);
  EXPECT_THROW(generate(model, features, emotion, std::nan(""), {}, core::make_generator(0)),
               std::invalid_argument);
  EXPECT_THROW(generate(model, features, changing_affect(5), {}, generators({1})),
               std::invalid_argument);
  EXPECT_THROW(generate(model, features, {changing_affect(4).emotion, torch::ones({2}), {}}, {},
                        generators({1})),
               std::invalid_argument);
  EXPECT_THROW(generate(model, features, changing_affect(4), {}, {}), std::invalid_argument);
  GenerateOptions options;
  options.precision = "float8";
  EXPECT_THROW(generate(model, features, emotion, 2.0, options, core::make_generator(0)),
               std::invalid_argument);
  // The generator is of another device: torch's own error, as the documented type.
  EXPECT_THROW(
      generate(model, features.to(torch::kMeta), emotion, 2.0, {}, core::make_generator(0)),
      std::runtime_error);
}

}  // namespace
}  // namespace freetalk::ats
