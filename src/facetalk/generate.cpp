#include "freetalk/facetalk/generate.h"

#include <torch/torch.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "facetalk/inference.h"
#include "freetalk/core/error.h"
#include "freetalk/core/random.h"
#include "freetalk/core/torch_error.h"

namespace freetalk::facetalk {
namespace {

/// Noise of frame after frame, the same however many are taken at a time.
class FrameNoise {
 public:
  FrameNoise(uint64_t seed, int64_t dim, const at::TensorOptions& options)
      : generator_(core::make_generator(seed, options.device())),
        drawn_(at::empty({0, dim}, options)) {}

  at::Tensor take(int64_t count) {
    while (drawn_.size(0) < count) {
      const auto block = at::randn({kBlock, drawn_.size(1)}, generator_, drawn_.options());
      drawn_ = at::cat({drawn_, block});
    }
    const at::Tensor taken = drawn_.narrow(0, 0, count);
    drawn_ = drawn_.slice(0, count).clone();
    return taken;
  }

  int64_t num_held() const { return drawn_.numel(); }

 private:
  static constexpr int64_t kBlock = 16;  // frames drawn at a time
  at::Generator generator_;
  at::Tensor drawn_;
};

GenerateOptions for_model(GenerateOptions options, const FaceTalkOptions& model) {
  options.check();
  if (!model.diffusion) {  // one pass, from nothing
    options.sampler = "ddim";
    options.num_steps = 1;
    options.eta = options.temperature = 0;
  }
  return options;
}

}  // namespace

diffusion::SamplerOptions GenerateOptions::sampler_options() const {
  return {sampler, num_steps, eta, spacing};
}

void GenerateOptions::check() const {
  sampler_options().check();
  FREETALK_CHECK(std::isfinite(audio_guidance), "audio_guidance must be finite");
  FREETALK_CHECK(temperature >= 0 && temperature <= 1,
                 "temperature must be between 0 and 1, found ", temperature);
  FREETALK_CHECK(piece_frames > 0, "piece_frames must be positive, found ", piece_frames);
  FREETALK_CHECK(precision == "float32" || precision == "bfloat16",
                 "precision must be float32 or bfloat16, found '", precision, "'");
}

struct CodeStream::State {
  FaceTalk model;
  GenerateOptions options;
  std::vector<uint64_t> seeds;
  diffusion::Schedule schedule;
  diffusion::SamplerOptions sampling;
  Inference network;
  /// Noise of each motion: that of the start, then of each step.
  std::vector<std::vector<FrameNoise>> noise;

  State(FaceTalk denoiser, std::vector<uint64_t> noise_seeds, const GenerateOptions& chosen)
      : model(std::move(denoiser)),
        options(for_model(chosen, model->options())),
        seeds(std::move(noise_seeds)),
        schedule(model->options().schedule_options()),
        sampling(options.sampler_options()),
        network(model, diffusion::sampler_timesteps(schedule, sampling), options.audio_guidance,
                options.precision == "bfloat16" ? at::kBFloat16 : at::kFloat) {
    FREETALK_CHECK(!seeds.empty(), "expected at least one seed");
    reset();
  }

  void reset() {
    network.reset();
    noise.assign(seeds.size(), {});
  }

  /// (K, n, code_dim) noise of a draw: the start is draw 0.
  at::Tensor draw(size_t number, int64_t frames) {
    const auto floats = model->rest_code().options().dtype(at::kFloat);
    std::vector<at::Tensor> drawn;
    for (size_t motion = 0; motion < seeds.size(); ++motion) {
      std::vector<FrameNoise>& own = noise[motion];
      while (own.size() <= number) {
        own.emplace_back(core::splitmix64(seeds[motion], own.size()), model->options().code_dim,
                         floats);
      }
      drawn.push_back(own[number].take(frames));
    }
    return at::stack(drawn) * options.temperature;
  }

  at::Tensor advance(const at::Tensor& features, const diffusion::StepCallback& on_step) {
    const torch::NoGradGuard no_grad;
    const FaceTalkOptions& own = model->options();
    FREETALK_CHECK(features.dim() == 2 && features.size(1) == own.audio_dim,
                   "expected features (n, ", own.audio_dim, "), found ", features.sizes());
    const auto count = static_cast<int64_t>(seeds.size());
    const int64_t frames = features.size(0);
    if (frames == 0) {
      return at::empty({count, 0, own.code_dim}, model->rest_code().options().dtype(at::kFloat));
    }
    network.hear(features.to(model->rest_code().options()), count);
    size_t draws = 1;
    const at::Tensor x0 = diffusion::sample(
        schedule,
        [&](const at::Tensor& x, int64_t timestep) { return network.denoise(x, timestep); },
        draw(0, frames), sampling, [&](const at::Tensor&) { return draw(draws++, frames); },
        on_step);
    return model->denormalize(x0).to(at::kFloat);
  }
};

CodeStream::CodeStream(FaceTalk model, std::vector<uint64_t> seeds,
                       const GenerateOptions& options) {
  core::with_plain_errors("CodeStream", [&] {
    FREETALK_CHECK(model->options().align_audio,
                   "a stream needs a model whose frames hear their own moment (align_audio)");
    state_ = std::make_unique<State>(std::move(model), std::move(seeds), options);
  });
}

CodeStream::~CodeStream() = default;
CodeStream::CodeStream(CodeStream&&) noexcept = default;

at::Tensor CodeStream::push(const at::Tensor& features, const diffusion::StepCallback& on_step) {
  return core::with_plain_errors("CodeStream", [&] { return state_->advance(features, on_step); });
}

void CodeStream::reset() { state_->reset(); }

int64_t CodeStream::num_held() const {
  int64_t count = state_->network.num_held();
  for (const auto& own : state_->noise) {
    for (const FrameNoise& one : own) count += one.num_held();
  }
  return count;
}

at::Tensor generate(FaceTalk& model, const at::Tensor& features, const GenerateOptions& options,
                    const std::vector<uint64_t>& seeds, const diffusion::StepCallback& on_step) {
  return core::with_plain_errors("generate", [&] {
    const FaceTalkOptions& own = model->options();
    FREETALK_CHECK(features.dim() == 2 && features.size(0) > 0 && features.size(1) == own.audio_dim,
                   "generate: expected features (T, ", own.audio_dim, "), found ",
                   features.sizes());
    const int64_t frames = features.size(0);
    const int64_t piece = own.align_audio ? std::max<int64_t>(1, options.piece_frames) : frames;
    const torch::NoGradGuard no_grad;
    CodeStream::State state(model, seeds, options);
    const int64_t pieces = (frames + piece - 1) / piece;
    std::vector<at::Tensor> codes;
    for (int64_t index = 0; index < pieces; ++index) {
      codes.push_back(state.advance(features.slice(0, index * piece, (index + 1) * piece),
                                    [&](int64_t done, int64_t total) {
                                      if (on_step) on_step(index * total + done, pieces * total);
                                    }));
    }
    return at::cat(codes, 1);
  });
}

}  // namespace freetalk::facetalk
