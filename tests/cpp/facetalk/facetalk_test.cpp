#include "freetalk/facetalk/facetalk.h"

#include <gtest/gtest.h>
#include <torch/torch.h>

#include "freetalk/core/random.h"
#include "freetalk/facetalk/generate.h"

namespace freetalk::facetalk {
namespace {

FaceTalkOptions small_options() {
  FaceTalkOptions options;
  options.code_dim = 6;
  options.audio_dim = 5;
  options.d_model = 16;
  options.num_layers = 2;
  options.num_heads = 2;
  options.ff_dim = 32;
  options.window = 4;
  options.max_frames = 16;
  return options;
}

FaceTalk small_model(const FaceTalkOptions& options) {
  torch::manual_seed(0);
  FaceTalk model(options);
  model->eval();
  return model;
}

at::Tensor drawn(at::IntArrayRef sizes, uint64_t seed) {
  return torch::randn(sizes, core::make_generator(seed));
}

/// Frames of 12 whose estimate changes where `change` is done to frame 6.
std::vector<int64_t> reached(FaceTalk& model,
                             const std::function<void(at::Tensor&, Condition&)>& change) {
  const torch::NoGradGuard no_grad;
  const at::Tensor timestep = torch::tensor({400});
  at::Tensor x = drawn({1, 12, 6}, 1);
  Condition condition{drawn({1, 12, 5}, 2), {}, {}};
  const at::Tensor before = model(x, timestep, condition);
  x = x.clone();
  condition.audio = condition.audio.clone();
  change(x, condition);
  const at::Tensor moved = (model(x, timestep, condition) - before).abs().amax(2).squeeze(0);
  std::vector<int64_t> frames;
  for (int64_t frame = 0; frame < 12; ++frame) {
    if (moved[frame].item<float>() > 1e-6F) frames.push_back(frame);
  }
  return frames;
}

TEST(FaceTalk, SeesTheWindowOfFramesBeforeAndNoLaterOne) {
  for (const char* condition : {"film", "scale_shift", "squeeze_excite", "dot_product", "input"}) {
    FaceTalkOptions options = small_options();
    options.time_condition = condition;
    options.num_layers = 1;
    FaceTalk model = small_model(options);
    const auto by_x = reached(model, [](at::Tensor& x, Condition&) { x.select(1, 6).add_(3); });
    EXPECT_EQ(by_x, (std::vector<int64_t>{6, 7, 8, 9})) << condition;
    // In one layer what is heard comes after self-attention: it stays where it is.
    const auto by_audio =
        reached(model, [](at::Tensor&, Condition& c) { c.audio.select(1, 6).add_(3); });
    EXPECT_EQ(by_audio, (std::vector<int64_t>{6})) << condition;
  }
}

TEST(FaceTalk, WithoutAlignmentEveryFrameHearsTheClipButNotPadding) {
  FaceTalkOptions options = small_options();
  options.align_audio = false;
  FaceTalk model = small_model(options);
  const auto heard =
      reached(model, [](at::Tensor&, Condition& c) { c.audio.select(1, 6).add_(3); });
  EXPECT_EQ(heard.size(), 12U);
  Condition condition{drawn({1, 8, 5}, 2), {}, torch::arange(8).lt(5).unsqueeze(0)};
  const at::Tensor x = drawn({1, 8, 6}, 1), timestep = torch::tensor({3});
  const at::Tensor before = model(x, timestep, condition).narrow(1, 0, 5);
  condition.audio = condition.audio.clone();
  condition.audio.narrow(1, 5, 3).add_(9);
  EXPECT_TRUE(torch::allclose(before, model(x, timestep, condition).narrow(1, 0, 5), 1e-5, 1e-6));
}

TEST(FaceTalk, TheStepIsToldInEveryWay) {
  for (const char* condition : {"film", "scale_shift", "squeeze_excite", "dot_product", "input"}) {
    FaceTalkOptions options = small_options();
    options.time_condition = condition;
    FaceTalk model = small_model(options);
    const at::Tensor x = drawn({1, 4, 6}, 1);
    const Condition heard{drawn({1, 4, 5}, 2), {}, {}};
    EXPECT_FALSE(torch::allclose(model(x, torch::tensor({10}), heard),
                                 model(x, torch::tensor({900}), heard), 1e-3, 1e-3))
        << condition;
  }
}

TEST(FaceTalk, RotaryPositionsDependOnDistancesAlone) {
  FaceTalk model = small_model(small_options());
  const at::Tensor timestep = torch::tensor({7});
  const at::Tensor x = drawn({1, 4, 6}, 1), audio = drawn({1, 4, 5}, 2);
  const at::Tensor alone = model(x, timestep, Condition{audio, {}, {}});
  // Two layers of a window of four reach six frames back: the last of ten see the same as...
  const at::Tensor longer =
      model(x.repeat({1, 4, 1}), timestep, Condition{audio.repeat({1, 4, 1}), {}, {}});
  EXPECT_TRUE(torch::allclose(longer.narrow(1, 8, 4), longer.narrow(1, 12, 4), 1e-4, 1e-5));
  EXPECT_TRUE(torch::allclose(longer.narrow(1, 0, 4), alone, 1e-4, 1e-5));
}

TEST(FaceTalk, DroppedAudioIsTheLearnedNull) {
  FaceTalk model = small_model(small_options());
  const at::Tensor x = drawn({2, 4, 6}, 1), timestep = torch::tensor({7, 7});
  Condition dropped{drawn({2, 4, 5}, 2), torch::tensor({true, false}), {}};
  Condition other{drawn({2, 4, 5}, 3), torch::tensor({true, false}), {}};
  const at::Tensor a = model(x, timestep, dropped), b = model(x, timestep, other);
  EXPECT_TRUE(torch::equal(a[0], b[0]));
  EXPECT_FALSE(torch::allclose(a[1], b[1], 1e-3, 1e-3));
}

TEST(FaceTalk, BadOptionsAndShapesAreNamed) {
  const auto refused = [](const std::function<void(FaceTalkOptions&)>& change) {
    FaceTalkOptions options = small_options();
    change(options);
    EXPECT_THROW(FaceTalk{options}, std::invalid_argument);
  };
  refused([](FaceTalkOptions& o) { o.codes = "blendshapes"; });
  refused([](FaceTalkOptions& o) { o.codes = "weights"; });  // without names
  refused([](FaceTalkOptions& o) { o.condition = "landmarks"; });
  refused([](FaceTalkOptions& o) { o.time_condition = "adain"; });
  refused([](FaceTalkOptions& o) { o.film_form = "eq19"; });
  refused([](FaceTalkOptions& o) { o.positions = "none"; });
  refused([](FaceTalkOptions& o) { o.time_layers = 4; });
  refused([](FaceTalkOptions& o) { o.num_heads = 3; });
  FaceTalkOptions learned = small_options();
  learned.positions = "learned";
  FaceTalk model = small_model(learned);
  const at::Tensor timestep = torch::tensor({1});
  EXPECT_NO_THROW(model(drawn({1, 16, 6}, 1), timestep, Condition{drawn({1, 16, 5}, 2), {}, {}}));
  EXPECT_THROW(model(drawn({1, 17, 6}, 1), timestep, Condition{drawn({1, 17, 5}, 2), {}, {}}),
               std::invalid_argument);
  EXPECT_THROW(model(drawn({1, 4, 7}, 1), timestep, Condition{drawn({1, 4, 5}, 2), {}, {}}),
               std::invalid_argument);
  EXPECT_THROW(model->set_code_statistics(torch::zeros({6}), torch::zeros({6}), torch::zeros({6}),
                                          torch::zeros({6, 204})),
               std::invalid_argument);
}

// generate() by plain means: the whole clip through forward() at each step.
at::Tensor generated_whole(FaceTalk& model, const at::Tensor& features, double guidance,
                           const at::Tensor& noise) {
  const torch::NoGradGuard no_grad;
  const diffusion::Schedule schedule(model->options().schedule_options());
  const auto denoise = [&](const at::Tensor& x, int64_t timestep) {
    Condition condition{features.unsqueeze(0), {}, {}};
    const at::Tensor step = torch::tensor({timestep});
    const at::Tensor with = model(x, step, condition);
    condition.drop_audio = torch::ones({1}, torch::kBool);
    return guidance * with + (1 - guidance) * model(x, step, condition);
  };
  const diffusion::SamplerOptions sampling{"ddim", 5, 0.0, "auto"};
  return model->denormalize(
      diffusion::sample(schedule, denoise, noise, sampling, core::make_generator(0)));
}

TEST(Generate, PiecesAndStreamsGiveTheWhole) {
  for (const char* sampler : {"ddim", "renoise", "ddpm", "dpmpp"}) {
    FaceTalk model = small_model(small_options());
    const at::Tensor features = drawn({37, 5}, 4);
    GenerateOptions options;
    options.sampler = sampler;
    options.num_steps = 5;
    options.audio_guidance = 1.5;
    const at::Tensor whole = generate(model, features, options, {3, 8});
    ASSERT_EQ(whole.sizes(), at::IntArrayRef({2, 37, 6}));
    options.piece_frames = 7;
    EXPECT_TRUE(torch::allclose(generate(model, features, options, {3, 8}), whole, 1e-4, 1e-5));
    EXPECT_TRUE(torch::allclose(generate(model, features, options, {8})[0], whole[1], 1e-4, 1e-5));
    CodeStream stream(model, {3}, options);
    for (int round = 0; round < 2; ++round) {
      std::vector<at::Tensor> codes;
      int64_t at = 0;
      for (const int64_t count : {1, 0, 2, 19, 15}) {
        codes.push_back(stream.push(features.slice(0, at, at + count)));
        at += count;
      }
      EXPECT_TRUE(torch::allclose(at::cat(codes, 1)[0], whole[0], 1e-4, 1e-5)) << sampler;
      stream.reset();
    }
  }
}

TEST(Generate, IsForwardOverTheWholeClip) {
  for (const char* condition : {"film", "scale_shift", "squeeze_excite", "dot_product", "input"}) {
    FaceTalkOptions options = small_options();
    options.time_condition = condition;
    FaceTalk model = small_model(options);
    model->set_code_statistics(torch::full({6}, 0.3), torch::full({6}, 2.0), torch::zeros({6}),
                               torch::zeros({6, 204}));
    const at::Tensor features = drawn({21, 5}, 4);
    GenerateOptions sampling;
    sampling.num_steps = 5;
    sampling.audio_guidance = 2.0;
    sampling.temperature = 0;  // both start from nothing
    sampling.piece_frames = 8;
    const at::Tensor expected = generated_whole(model, features, 2.0, torch::zeros({1, 21, 6}));
    EXPECT_TRUE(torch::allclose(generate(model, features, sampling, {1}), expected, 1e-4, 1e-5))
        << condition;
  }
}

TEST(Generate, WithoutDiffusionThereIsOneAnswerInOnePass) {
  FaceTalkOptions options = small_options();
  options.diffusion = false;
  FaceTalk model = small_model(options);
  const at::Tensor features = drawn({9, 5}, 4);
  int64_t steps = 0;
  const at::Tensor one = generate(model, features, {}, {1}, [&](int64_t, int64_t) { ++steps; });
  EXPECT_EQ(steps, 1);
  EXPECT_TRUE(torch::equal(one, generate(model, features, {}, {2})));
}

TEST(Generate, MemoryOfAStreamStopsGrowing) {
  FaceTalk model = small_model(small_options());
  GenerateOptions options;
  options.num_steps = 3;
  CodeStream stream(model, {3}, options);
  stream.push(drawn({16, 5}, 1));
  const int64_t held = stream.num_held();
  for (int round = 0; round < 5; ++round) stream.push(drawn({16, 5}, 1));
  EXPECT_EQ(stream.num_held(), held);
}

TEST(Generate, BadInputIsNamed) {
  FaceTalk model = small_model(small_options());
  EXPECT_THROW(generate(model, drawn({4, 6}, 1), {}, {1}), std::invalid_argument);
  EXPECT_THROW(generate(model, drawn({4, 5}, 1), {}, {}), std::invalid_argument);
  GenerateOptions options;
  options.temperature = 2;
  EXPECT_THROW(generate(model, drawn({4, 5}, 1), options, {1}), std::invalid_argument);
  FaceTalkOptions whole = small_options();
  whole.align_audio = false;
  EXPECT_THROW(CodeStream(small_model(whole), {1}), std::invalid_argument);
  EXPECT_EQ(
      generate(*std::make_unique<FaceTalk>(small_model(whole)), drawn({4, 5}, 1), {}, {1}).sizes(),
      at::IntArrayRef({1, 4, 6}));
}

}  // namespace
}  // namespace freetalk::facetalk
