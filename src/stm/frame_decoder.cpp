#include "freetalk/stm/frame_decoder.h"

#include <ATen/autocast_mode.h>
#include <torch/torch.h>

#include <algorithm>

#include "core/parallel.h"
#include "freetalk/core/error.h"
#include "freetalk/nn/diffusion_net.h"
#include "nn/fused_diffusion.h"

namespace freetalk::stm {
namespace {

constexpr int64_t kMaxChunk = 64;  // frames; more would not use the caches better

/// bfloat16 autocast of a device while it lives.
class Autocast {
 public:
  explicit Autocast(c10::DeviceType device)
      : device_(device),
        enabled_(at::autocast::is_autocast_enabled(device)),
        dtype_(at::autocast::get_autocast_dtype(device)) {
    at::autocast::set_autocast_enabled(device, true);
    at::autocast::set_autocast_dtype(device, at::kBFloat16);
    at::autocast::increment_nesting();
  }
  ~Autocast() {
    if (at::autocast::decrement_nesting() == 0) at::autocast::clear_cache();
    at::autocast::set_autocast_dtype(device_, dtype_);
    at::autocast::set_autocast_enabled(device_, enabled_);
  }
  Autocast(const Autocast&) = delete;
  Autocast& operator=(const Autocast&) = delete;

 private:
  c10::DeviceType device_;
  bool enabled_;
  at::ScalarType dtype_;
};

}  // namespace

void DecodeOptions::check() const {
  FREETALK_CHECK(precision == "float32" || precision == "bfloat16",
                 "STM: precision must be float32 or bfloat16, found ", precision);
  FREETALK_CHECK(memory_bytes > 0, "STM: memory_bytes must be positive, found ", memory_bytes);
}

FrameDecoder::FrameDecoder(std::shared_ptr<StmImpl> model, const MeshFeatures& mesh,
                           const geometry::SurfaceOperators& operators,
                           const DecodeOptions& options)
    : model_(std::move(model)), mesh_(mesh), operators_(operators), options_(options) {
  options.check();
  const torch::NoGradGuard no_grad;
  auto* net = dynamic_cast<nn::DiffusionNetImpl*>(model_->decoder().get());
  if (net != nullptr && nn::FusedDiffusion::supports(*net, operators) && mesh.hidden.is_cpu()) {
    fused_ = std::make_unique<nn::FusedDiffusion>(*net, operators, mesh.hidden, mesh.queries,
                                                  options.precision == "bfloat16");
  }
}

FrameDecoder::~FrameDecoder() = default;

FrameDecoder::Plan FrameDecoder::plan() const {
  const int64_t vertices = operators_.num_vertices();
  if (!fused_) return {model_->frames_per_chunk(vertices, options_.memory_bytes), 1};
  const int64_t of_work = fused_->bytes_per_frame();
  const int64_t in_work =
      std::clamp<int64_t>(options_.memory_bytes / of_work, 1, core::num_threads());
  const auto& o = model_->options();
  const int64_t of_inputs =
      3 * 68 *
      (o.gcn_hidden + o.index_code_dim + 2 * o.attention_dim + o.attention_heads * o.decoder_width);
  const int64_t of_frame = 4 * (2 * 3 * vertices + of_inputs);
  const int64_t left = options_.memory_bytes - in_work * of_work;
  return {std::clamp<int64_t>(left / of_frame / in_work * in_work, in_work, kMaxChunk), in_work};
}

nn::FrameInputs FrameDecoder::inputs_of(const at::Tensor& landmarks) const {
  std::vector<nn::FrameInputs> frames(static_cast<size_t>(landmarks.size(0)));
  core::parallel_for(0, landmarks.size(0), 1, [&](int64_t begin, int64_t end) {
    for (int64_t t = begin; t < end; ++t) {
      frames[static_cast<size_t>(t)] = model_->frame_inputs(landmarks.narrow(0, t, 1));
    }
  });
  const auto join = [&frames](at::Tensor nn::FrameInputs::*field) {
    if (!(frames.front().*field).defined()) return at::Tensor();
    std::vector<at::Tensor> parts;
    for (const nn::FrameInputs& frame : frames) parts.push_back(frame.*field);
    return at::cat(parts);
  };
  return {join(&nn::FrameInputs::offsets), join(&nn::FrameInputs::keys),
          join(&nn::FrameInputs::values)};
}

at::Tensor FrameDecoder::decode_chunk(const at::Tensor& landmarks, int64_t in_work) const {
  if (fused_) {
    return fused_->run(inputs_of(landmarks), landmarks.size(0), in_work)
        .mul_(model_->options().displacement_scale);
  }
  if (options_.precision == "bfloat16") {
    const Autocast autocast(landmarks.device().type());
    return model_->decode(mesh_, operators_, landmarks).to(at::kFloat);
  }
  return model_->decode(mesh_, operators_, landmarks);
}

void FrameDecoder::decode(const at::Tensor& landmarks,
                          const std::function<void(int64_t, const at::Tensor&)>& sink) const {
  const torch::NoGradGuard no_grad;
  const auto [chunk, in_work] = plan();
  for (int64_t first = 0; first < landmarks.size(0); first += chunk) {
    const int64_t count = std::min(chunk, landmarks.size(0) - first);
    sink(first, decode_chunk(landmarks.narrow(0, first, count), in_work));
  }
}

at::Tensor FrameDecoder::decode(const at::Tensor& landmarks) const {
  at::Tensor result = at::empty({landmarks.size(0), operators_.num_vertices(), 3},
                                landmarks.options().dtype(at::kFloat));
  decode(landmarks, [&result](int64_t first, const at::Tensor& part) {
    result.narrow(0, first, part.size(0)).copy_(part);
  });
  return result;
}

void decode_chunked(Stm& model, const MeshFeatures& mesh,
                    const geometry::SurfaceOperators& operators, const at::Tensor& landmarks,
                    const std::function<void(int64_t, const at::Tensor&)>& sink,
                    const DecodeOptions& options) {
  FrameDecoder(model.ptr(), mesh, operators, options).decode(landmarks, sink);
}

}  // namespace freetalk::stm
