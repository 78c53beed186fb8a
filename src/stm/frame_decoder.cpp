#include "freetalk/stm/frame_decoder.h"

#include <ATen/DeviceAccelerator.h>
#include <c10/core/Event.h>
#include <c10/core/impl/VirtualGuardImpl.h>
#include <torch/torch.h>

#include <algorithm>
#include <mutex>
#include <optional>

#include "core/autocast.h"
#include "core/parallel.h"
#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "freetalk/core/torch_error.h"
#include "freetalk/nn/diffusion_net.h"
#include "nn/fused_diffusion.h"

namespace freetalk::stm {
namespace {

constexpr int64_t kMaxChunk = 64;                   // frames; more would not use the caches better
constexpr int64_t kEnoughOnGpu = int64_t{4} << 30;  // bytes; more does not make it faster

/// Working memory: what the options say; on a GPU up to half of what is free, where that is more.
int64_t working_memory(const c10::Device& device, int64_t bytes) {
  if (!device.is_cuda()) return bytes;
  const auto free = at::getDeviceAllocator(device.type())->getMemoryInfo(device.index()).first;
  return std::max(bytes, std::min(static_cast<int64_t>(free / 2), kEnoughOnGpu));
}

/// Hands parts on to the host, those of a GPU through pinned memory and one late: the next one is
/// computed while the host waits for the copy and uses it.
class ToHost {
 public:
  using Sink = std::function<void(int64_t, const at::Tensor&)>;
  explicit ToHost(const Sink& sink) : sink_(sink) {}

  void push(int64_t first, const at::Tensor& part) {
    if (!part.is_cuda()) {
      sink_(first, part.to(at::kCPU));
      return;
    }
    at::Tensor copy = at::empty(
        part.sizes(), at::TensorOptions(at::kCPU).dtype(part.scalar_type()).pinned_memory(true));
    copy.copy_(part, /*non_blocking=*/true);
    c10::Event copied(part.device().type());
    copied.record(c10::impl::VirtualGuardImpl(part.device().type()).getStream(part.device()));
    finish();
    pending_.emplace(Pending{first, copy, std::move(copied)});
  }

  void finish() {
    if (!pending_) return;
    pending_->copied.synchronize();
    sink_(pending_->first, pending_->copy);
    pending_.reset();
  }

 private:
  struct Pending {
    int64_t first;
    at::Tensor copy;
    c10::Event copied;
  };
  const Sink& sink_;
  std::optional<Pending> pending_;
};

}  // namespace

void DecodeOptions::check() const {
  FREETALK_CHECK(precision == "float32" || precision == "bfloat16",
                 "STM: precision must be float32 or bfloat16, found ", precision);
  FREETALK_CHECK(memory_bytes > 0, "STM: memory_bytes must be positive, found ", memory_bytes);
}

struct FrameDecoder::Made {
  std::once_flag fused_once, fastest_once;
  std::unique_ptr<const nn::FusedDiffusion> fused;
  std::unique_ptr<const FrameDecoder> fastest;
};

FrameDecoder::FrameDecoder(std::shared_ptr<StmImpl> model, const MeshFeatures& mesh,
                           const geometry::SurfaceOperators& operators,
                           const DecodeOptions& options,
                           std::shared_ptr<const LandmarkFollower> follower)
    : model_(std::move(model)),
      mesh_(mesh),
      operators_(operators),
      options_(options),
      follower_(std::move(follower)),
      made_(std::make_unique<Made>()) {
  options.check();
  auto* net = dynamic_cast<nn::DiffusionNetImpl*>(model_->decoder().get());
  can_fuse_ =
      net != nullptr && nn::FusedDiffusion::supports(*net, operators) && mesh.hidden.is_cpu();
}

FrameDecoder::~FrameDecoder() = default;

const nn::FusedDiffusion* FrameDecoder::fused() const {
  if (!can_fuse_) return nullptr;
  std::call_once(made_->fused_once, [this] {
    const torch::NoGradGuard no_grad;
    auto& net = dynamic_cast<nn::DiffusionNetImpl&>(*model_->decoder());
    const int64_t attended = mesh_.queries.defined() ? model_->options().attention_dim : 0;
    const at::Tensor& weight = net.first_lin->weight;
    made_->fused = std::make_unique<const nn::FusedDiffusion>(
        net, operators_,
        nn::FusedInput{mesh_.hidden, mesh_.queries,
                       weight.narrow(1, weight.size(1) - attended, attended)},
        options_.precision == "bfloat16");
  });
  return made_->fused.get();
}

const FrameDecoder& FrameDecoder::fastest() const {
  if (!can_fuse_ || options_.precision == "bfloat16" || !nn::FusedDiffusion::supports_bfloat16()) {
    return *this;
  }
  std::call_once(made_->fastest_once, [this] {
    made_->fastest = std::make_unique<const FrameDecoder>(
        model_, mesh_, operators_, DecodeOptions{"bfloat16", options_.memory_bytes}, follower_);
  });
  return *made_->fastest;
}

FrameDecoder::Plan FrameDecoder::plan() const {
  const int64_t vertices = operators_.num_vertices();
  const nn::FusedDiffusion* fast = fused();
  if (fast == nullptr) {
    const int64_t bytes = working_memory(mesh_.hidden.device(), options_.memory_bytes);
    return {model_->frames_per_chunk(vertices, bytes), 1};
  }
  const int64_t of_work = fast->bytes_per_frame();
  const int64_t in_work =
      std::clamp<int64_t>(options_.memory_bytes / of_work, 1, core::num_threads());
  const auto& o = model_->options();
  const int64_t of_inputs =
      core::kMotionDim * (o.gcn_hidden + o.index_code_dim + 3 * o.attention_dim);
  const int64_t of_frame = 4 * (2 * 3 * vertices + of_inputs);
  const int64_t left = options_.memory_bytes - in_work * of_work;
  return {std::clamp<int64_t>(left / of_frame / in_work * in_work, in_work, kMaxChunk), in_work};
}

FrameInputs FrameDecoder::inputs_of(const at::Tensor& landmarks) const {
  std::vector<FrameInputs> frames(static_cast<size_t>(landmarks.size(0)));
  core::parallel_for(0, landmarks.size(0), 1, [&](int64_t begin, int64_t end) {
    for (int64_t t = begin; t < end; ++t) {
      frames[static_cast<size_t>(t)] = model_->frame_inputs(landmarks.narrow(0, t, 1));
    }
  });
  const auto join = [&frames](at::Tensor FrameInputs::*field) {
    if (!(frames.front().*field).defined()) return at::Tensor();
    std::vector<at::Tensor> parts;
    for (const FrameInputs& frame : frames) parts.push_back(frame.*field);
    return at::cat(parts);
  };
  return {join(&FrameInputs::offsets), join(&FrameInputs::keys), join(&FrameInputs::values)};
}

at::Tensor FrameDecoder::decode_chunk(const at::Tensor& landmarks, int64_t in_work) const {
  if (const nn::FusedDiffusion* fast = fused()) {
    const FrameInputs inputs = inputs_of(landmarks);
    return fast->run({inputs.offsets, inputs.keys, inputs.values}, landmarks.size(0), in_work)
        .mul_(model_->options().displacement_scale);
  }
  if (options_.precision == "bfloat16") {
    const core::Bfloat16Scope bfloat16(landmarks.device().type());
    return model_->decode(mesh_, operators_, landmarks).to(at::kFloat);
  }
  return model_->decode(mesh_, operators_, landmarks);
}

void FrameDecoder::each_chunk(const at::Tensor& landmarks,
                              const std::function<void(int64_t, const at::Tensor&)>& use) const {
  core::with_plain_errors("STM", [&] {
    const torch::NoGradGuard no_grad;
    const auto [chunk, in_work] = plan();
    for (int64_t first = 0; first < landmarks.size(0); first += chunk) {
      const int64_t count = std::min(chunk, landmarks.size(0) - first);
      const at::Tensor part = landmarks.narrow(0, first, count);
      const at::Tensor decoded = decode_chunk(part, in_work);
      use(first, follower_ ? follower_->apply_frames(decoded, part) : decoded);
    }
  });
}

void FrameDecoder::decode(const at::Tensor& landmarks,
                          const std::function<void(int64_t, const at::Tensor&)>& sink) const {
  ToHost host(sink);
  each_chunk(landmarks, [&host](int64_t first, const at::Tensor& part) { host.push(first, part); });
  host.finish();
}

at::Tensor FrameDecoder::decode(const at::Tensor& landmarks) const {
  at::Tensor result = at::empty({landmarks.size(0), operators_.num_vertices(), 3},
                                landmarks.options().dtype(at::kFloat));
  each_chunk(landmarks, [&result](int64_t first, const at::Tensor& part) {
    result.narrow(0, first, part.size(0)).copy_(part);
  });
  return result;
}

at::Tensor FrameDecoder::decode_once(const at::Tensor& landmarks) const {
  return FrameDecoder(model_, mesh_, operators_, options_, follower_).decode(landmarks);
}

void decode_chunked(Stm& model, const MeshFeatures& mesh,
                    const geometry::SurfaceOperators& operators, const at::Tensor& landmarks,
                    const std::function<void(int64_t, const at::Tensor&)>& sink,
                    const DecodeOptions& options) {
  FrameDecoder(model.ptr(), mesh, operators, options).decode(landmarks, sink);
}

}  // namespace freetalk::stm
