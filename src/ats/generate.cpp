#include "freetalk/ats/generate.h"

#include <torch/torch.h>

#include <cstdlib>
#include <map>
#include <sstream>

#include "freetalk/core/error.h"

namespace freetalk::ats {
namespace {

/// Weights of one window's frames: ramps over the overlaps with its neighbours, so that all
/// windows' sum to one after division by their total.
at::Tensor fade_weights(int64_t frames, int64_t overlap) {
  const at::Tensor index = at::arange(frames, at::kFloat);
  const at::Tensor edge = at::minimum(index, static_cast<double>(frames - 1) - index);
  return ((edge + 1) / static_cast<double>(overlap + 1)).clamp_max(1.0);
}

/// Denoises a whole sequence by windows.
class WindowedDenoiser {
 public:
  WindowedDenoiser(Ats& model, const at::Tensor& features, const at::Tensor& emotion,
                   double intensity, const GenerateOptions& options)
      : model_(model), features_(features), options_(options) {
    const int64_t frames = features.size(0);
    window_ = std::min(frames, model->options().max_frames);
    starts_ = window_starts(frames, window_, std::min(options.window_overlap, window_ - 1));
    emotion_ = emotion.to(features.options()).unsqueeze(0);
    intensity_ = at::full({1}, intensity, features.options());
    fade_ =
        (starts_.size() > 1 ? fade_weights(window_, options.window_overlap) : at::ones({window_}))
            .to(features.device())
            .unsqueeze(1);
  }

  at::Tensor operator()(const at::Tensor& x, int64_t timestep) {
    at::Tensor sum = at::zeros_like(x), total = at::zeros({x.size(0), 1}, x.options());
    const auto batch = static_cast<size_t>(options_.windows_per_batch);
    for (size_t first = 0; first < starts_.size(); first += batch) {
      const size_t last = std::min(first + batch, starts_.size());
      std::vector<at::Tensor> windows, audio;
      for (size_t i = first; i < last; ++i) {
        windows.push_back(x.narrow(0, starts_[i], window_));
        audio.push_back(features_.narrow(0, starts_[i], window_));
      }
      const at::Tensor x0 = guided(at::stack(windows), at::stack(audio), timestep);
      for (size_t i = first; i < last; ++i) {
        sum.narrow(0, starts_[i], window_).add_(x0[static_cast<int64_t>(i - first)] * fade_);
        total.narrow(0, starts_[i], window_).add_(fade_);
      }
    }
    return sum / total;
  }

 private:
  at::Tensor guided(const at::Tensor& x, const at::Tensor& audio, int64_t timestep) {
    const int64_t batch = x.size(0);
    const at::Tensor step = at::full({batch}, timestep, x.options().dtype(at::kLong));
    const at::Tensor dropped = at::ones({batch}, x.options().dtype(at::kBool));
    Condition condition{audio, emotion_.expand({batch, -1}), intensity_.expand({batch}), {}, {},
                        {}};
    const at::Tensor conditional = model_(x, step, condition);
    at::Tensor result = conditional;
    if (options_.audio_guidance != 1.0) {
      condition.drop_audio = dropped;
      result = result + (options_.audio_guidance - 1) * (conditional - model_(x, step, condition));
      condition.drop_audio = at::Tensor();
    }
    if (options_.affect_guidance != 1.0) {
      condition.drop_affect = dropped;
      result = result + (options_.affect_guidance - 1) * (conditional - model_(x, step, condition));
    }
    return result;
  }

  Ats& model_;
  at::Tensor features_, emotion_, intensity_, fade_;
  GenerateOptions options_;
  int64_t window_ = 0;
  std::vector<int64_t> starts_;
};

const std::map<std::string, std::string>& emotion_aliases() {
  static const std::map<std::string, std::string> aliases = {
      {"fear", "afraid"},        {"fearful", "afraid"},       {"anger", "angry"},
      {"happiness", "happy"},    {"sadness", "sad"},          {"disgusted", "disgust"},
      {"surprised", "surprise"}, {"contemptuous", "contempt"}};
  return aliases;
}

int64_t emotion_index(const std::string& name, const std::vector<std::string>& emotions) {
  const auto alias = emotion_aliases().find(name);
  const std::string& canonical = alias == emotion_aliases().end() ? name : alias->second;
  for (size_t i = 0; i < emotions.size(); ++i) {
    if (emotions[i] == canonical) return static_cast<int64_t>(i);
  }
  std::string known;
  for (const std::string& emotion : emotions) known += (known.empty() ? "" : ", ") + emotion;
  throw std::invalid_argument(core::join("unknown emotion '", name, "'; known are: ", known));
}

}  // namespace

void GenerateOptions::check() const {
  diffusion::DdimOptions{num_steps, eta, spacing}.check();
  FREETALK_CHECK(window_overlap >= 0, "window_overlap must not be negative, found ",
                 window_overlap);
  FREETALK_CHECK(windows_per_batch > 0, "windows_per_batch must be positive, found ",
                 windows_per_batch);
}

std::vector<int64_t> window_starts(int64_t num_frames, int64_t window, int64_t overlap) {
  FREETALK_CHECK(window > 0 && overlap >= 0 && overlap < std::max<int64_t>(window, 1),
                 "windows of ", window, " frames cannot overlap by ", overlap);
  if (num_frames <= window) return {0};
  const int64_t span = num_frames - window, step = window - overlap;
  const int64_t count = (span + step - 1) / step;
  std::vector<int64_t> starts;
  for (int64_t i = 0; i <= count; ++i) starts.push_back(span * i / count);
  return starts;
}

at::Tensor generate(Ats& model, const at::Tensor& features, const at::Tensor& emotion,
                    double intensity, const GenerateOptions& options, at::Generator generator,
                    const diffusion::StepCallback& on_step) {
  options.check();
  const AtsOptions& own = model->options();
  FREETALK_CHECK(features.dim() == 2 && features.size(0) > 0 && features.size(1) == own.audio_dim,
                 "generate: expected features (T, ", own.audio_dim, "), found ", features.sizes());
  FREETALK_CHECK(emotion.dim() == 1 && emotion.size(0) == static_cast<int64_t>(own.emotions.size()),
                 "generate: expected emotion (", own.emotions.size(), ",), found ",
                 emotion.sizes());
  FREETALK_CHECK(intensity >= 1 && intensity <= static_cast<double>(own.num_intensities),
                 "intensity must be between 1 and ", own.num_intensities, ", found ", intensity);
  const torch::NoGradGuard no_grad;
  const diffusion::Schedule schedule(own.schedule_options());
  WindowedDenoiser denoiser(model, features, emotion, intensity, options);
  const at::Tensor noise = at::randn({features.size(0), kMotionDim}, generator, features.options());
  const at::Tensor x0 = diffusion::ddim_sample(
      schedule, [&](const at::Tensor& x, int64_t timestep) { return denoiser(x, timestep); }, noise,
      {options.num_steps, options.eta, options.spacing}, generator, on_step);
  return model->denormalize(x0).to(at::kFloat).view({-1, kNumLandmarks, 3});
}

at::Tensor parse_emotion(const std::string& text, const std::vector<std::string>& emotions) {
  std::vector<float> mixture(emotions.size(), 0.0F);
  float total = 0;
  std::istringstream parts(text);
  for (std::string part; std::getline(parts, part, ',');) {
    const size_t colon = part.find(':');
    float weight = 1;
    if (colon != std::string::npos) {
      const std::string number = part.substr(colon + 1);
      char* end = nullptr;
      weight = std::strtof(number.c_str(), &end);
      FREETALK_CHECK(!number.empty() && *end == '\0' && weight >= 0 && weight < 1e6F, "emotion '",
                     text, "': the weight '", number, "' is not a number >= 0");
    }
    mixture[static_cast<size_t>(emotion_index(part.substr(0, colon), emotions))] += weight;
    total += weight;
  }
  FREETALK_CHECK(total > 0, "emotion '", text, "' names no emotion with a positive weight");
  return torch::tensor(mixture) / total;
}

}  // namespace freetalk::ats
