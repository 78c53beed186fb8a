#include "head_decoder.h"

#include <torch/torch.h>

#include <algorithm>
#include <utility>

#include "freetalk/core/error.h"
#include "rig/shape_solver.h"

namespace freetalk::talker {
namespace {

constexpr int64_t kChunk = 32;  // frames of a call to the sink

/// ARKit's name of a shape of ICT-FaceKit.
std::string arkit_name(const std::string& name) {
  const size_t stem = name.size() < 2 ? 0 : name.size() - 2;
  if (name.substr(stem) == "_L") return name.substr(0, stem) + "Left";
  if (name.substr(stem) == "_R") return name.substr(0, stem) + "Right";
  return name;
}

/// (204, S) mm, one shape a column.
Eigen::MatrixXd columns_of(const at::Tensor& shapes) {
  const at::Tensor rows = (1e3 * shapes.to(at::kDouble)).flatten(1).contiguous();
  return Eigen::Map<const Eigen::MatrixXd>(rows.const_data_ptr<double>(), rows.size(1),
                                           rows.size(0));
}

}  // namespace

at::Tensor weights_of_shapes(const std::vector<std::string>& shapes,
                             const head::HeadOptions& options) {
  FREETALK_RUNTIME_CHECK(!options.expressions.empty(),
                         "the head names no expressions: its weights cannot be found from speech");
  at::Tensor result =
      at::zeros({static_cast<int64_t>(shapes.size()), options.num_weights}, at::kFloat);
  auto values = result.accessor<float, 2>();
  const auto index_of = [&](const std::string& name) {
    return std::find(shapes.begin(), shapes.end(), name) - shapes.begin();
  };
  for (int64_t weight = 0; weight < options.num_weights; ++weight) {
    const std::string& own = options.expressions[static_cast<size_t>(weight)];
    const std::string name = arkit_name(own);
    auto shape = index_of(name);
    if (shape == std::ssize(shapes) && name != own) shape = index_of(own.substr(0, own.size() - 2));
    if (shape < std::ssize(shapes)) values[shape][weight] = 1;
  }
  return result;
}

struct HeadDecoder::Shapes {
  rig::ShapeSolver solver;
  at::Tensor weights;  // (S, num_weights)
};

struct HeadDecoder::Fastest {
  std::once_flag once;
  std::unique_ptr<const HeadDecoder> decoder;
};

HeadDecoder::HeadDecoder(const head::PreparedHead& head, const rig::RigPoses& rig,
                         const at::Tensor& canonical, const at::Tensor& share,
                         std::shared_ptr<const stm::LandmarkFollower> follower)
    : head_(head),
      shapes_(std::make_shared<const Shapes>(
          Shapes{{columns_of(rig.shapes), rig.names, rig::RigOptions{}},
                 weights_of_shapes(rig.names, head.options())})),
      num_points_(canonical.size(0)),
      moving_(share.gt(0).nonzero().squeeze(1)),
      canonical_((canonical.index_select(0, moving_) * head.options().units_per_metre)
                     .to(at::kFloat)
                     .contiguous()),
      share_(share.index_select(0, moving_).unsqueeze(1) / head.options().units_per_metre),
      posed_(head_.to_posed(canonical_, head_.head()->rest_expression)),
      follower_(std::move(follower)),
      fastest_(std::make_unique<Fastest>()) {}

HeadDecoder::HeadDecoder(const HeadDecoder& other, const head::PreparedHead& head)
    : head_(head),
      shapes_(other.shapes_),
      num_points_(other.num_points_),
      moving_(other.moving_),
      canonical_(other.canonical_),
      share_(other.share_),
      posed_(head_.to_posed(canonical_, head_.head()->rest_expression)),
      follower_(other.follower_),
      fastest_(std::make_unique<Fastest>()) {}

HeadDecoder::~HeadDecoder() = default;

at::Tensor HeadDecoder::weights_of(const at::Tensor& landmarks) const {
  const at::Tensor rows =
      (1e3 * landmarks.to(at::kCPU, at::kDouble)).flatten(1).contiguous();  // mm
  at::Tensor weights = at::empty({rows.size(0), shapes_->weights.size(1)}, at::kFloat);
  for (int64_t frame = 0; frame < rows.size(0); ++frame) {
    std::vector<double> found(static_cast<size_t>(shapes_->weights.size(0)), 0.0);
    shapes_->solver.solve(
        Eigen::Map<const Eigen::VectorXd>(rows[frame].const_data_ptr<double>(), rows.size(1)),
        found);
    // Alone, so that its bits depend on no other frame.
    weights[frame].copy_(at::tensor(found).to(at::kFloat).unsqueeze(0).matmul(shapes_->weights)[0]);
  }
  return weights;
}

at::Tensor HeadDecoder::codes_of(const at::Tensor& landmarks) const {
  const torch::NoGradGuard no_grad;
  const at::Tensor weights = weights_of(landmarks);
  head::ParametricHead model = head_.head();
  at::Tensor codes = at::empty({weights.size(0), model->options().expression_dim}, at::kFloat);
  for (int64_t frame = 0; frame < weights.size(0); ++frame) {
    codes[frame].copy_(model->expression_code(weights.narrow(0, frame, 1))[0]);
  }
  return codes;
}

at::Tensor HeadDecoder::codes_of(const at::Tensor& codes, const facetalk::FaceTalkOptions& options,
                                 const at::Tensor& spoken, const at::Tensor& landmarks) const {
  const torch::NoGradGuard no_grad;
  if (options.codes == "head") return codes + codes_of(landmarks) - codes_of(spoken);
  head::ParametricHead model = head_.head();
  const auto& own = model->options().expressions;
  at::Tensor weights = weights_of(landmarks) - weights_of(spoken);
  for (size_t channel = 0; channel < options.expressions.size(); ++channel) {
    const auto found = std::find(own.begin(), own.end(), options.expressions[channel]);
    if (found == own.end()) continue;
    weights.select(1, found - own.begin()).add_(codes.select(1, static_cast<int64_t>(channel)));
  }
  return model->expression_code(weights.clamp(0, 1));
}

void HeadDecoder::decode_codes(const at::Tensor& codes, const at::Tensor& landmarks,
                               const std::function<void(int64_t, const at::Tensor&)>& sink) const {
  for (int64_t first = 0; first < codes.size(0); first += kChunk) {
    const int64_t count = std::min(kChunk, codes.size(0) - first);
    at::Tensor part = at::zeros({count, num_points_, 3}, at::kFloat);
    for (int64_t frame = 0; frame < count; ++frame) {
      const at::Tensor posed = head_.to_posed(canonical_, codes[first + frame]);
      part[frame].index_copy_(0, moving_, (posed - posed_) * share_);
    }
    sink(first,
         follower_ ? follower_->apply_frames(part, landmarks.narrow(0, first, count)) : part);
  }
}

void HeadDecoder::decode(const at::Tensor& landmarks,
                         const std::function<void(int64_t, const at::Tensor&)>& sink) const {
  decode_codes(codes_of(landmarks), landmarks.to(at::kCPU), sink);
}

at::Tensor HeadDecoder::decode(const at::Tensor& landmarks) const {
  at::Tensor result = at::empty({landmarks.size(0), num_points_, 3}, at::kFloat);
  decode(landmarks, [&result](int64_t first, const at::Tensor& part) {
    result.narrow(0, first, part.size(0)).copy_(part);
  });
  return result.to(landmarks.device());
}

const stm::LandmarkDecoder& HeadDecoder::fastest() const {
  std::call_once(fastest_->once, [this] {
    fastest_->decoder.reset(new HeadDecoder(*this, {head_.head(), head_.z_id(), {"bfloat16"}}));
  });
  return *fastest_->decoder;
}

}  // namespace freetalk::talker
