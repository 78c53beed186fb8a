#include "nn/field_inference.h"

#include <torch/torch.h>

#include <algorithm>
#include <cmath>
#include <type_traits>

#include "core/work_pool.h"
#include "nn/fused_layout.h"

namespace freetalk::nn {

class PackedFieldMlp::Engine {
 public:
  virtual ~Engine() = default;
  virtual FoldedCode fold(const at::Tensor& code) const = 0;
  virtual void run(const float* points, int64_t count, const FoldedCode& code,
                   float* result) const = 0;
};

namespace {

using fused::padded;
using fused::plain;
using fused::round_up;
using kernels::Epilogue;
using kernels::Kernels;
using kernels::kTile;
using kernels::Segment;

std::vector<float> padded_row(const at::Tensor& x, int64_t columns) {
  const at::Tensor row = plain(x);
  std::vector<float> result(static_cast<size_t>(columns), 0.0F);
  std::copy_n(row.const_data_ptr<float>(), row.numel(), result.begin());
  return result;
}

/// A weight (out, in) as a packed right operand, padded to (rows, columns).
template <class T>
std::vector<T> packed(const Kernels<T>& kernels, const at::Tensor& weight, int64_t rows,
                      int64_t columns) {
  const at::Tensor operand = padded(plain(weight).t(), rows, columns);
  std::vector<T> result(static_cast<size_t>(rows * columns));
  kernels.pack(operand.const_data_ptr<float>(), rows, columns, result.data());
  return result;
}

template <class T>
class PackedEngine final : public PackedFieldMlp::Engine {
 public:
  PackedEngine(const Kernels<T>& kernels, const FieldMlpOptions& options,
               const PackedFieldMlp::Layers& layers)
      : kernels_(kernels), floats_(kernels::float_kernels()), options_(options) {
    const int64_t point = options.point_dim, code = options.code_dim;
    for (int64_t index = 0; index < options.num_layers; ++index) {
      const auto& [given, bias] = layers[static_cast<size_t>(index)];
      const bool joins = index == 0 || index == options.skip_layer();
      const bool skip = joins && index > 0;
      const at::Tensor weight = plain(given) * (skip ? std::sqrt(0.5) : 1.0);
      Layer layer;
      layer.columns = round_up(weight.size(0), std::max(kernels.panel, floats_.panel));
      layer.bias = padded_row(bias, layer.columns);
      const int64_t hidden = weight.size(1) - (joins ? point + code : 0);
      if (index > 0) {
        layer.rows = layers_.back().columns;
        layer.hidden = packed(kernels, weight.narrow(1, 0, hidden), layer.rows, layer.columns);
      }
      if (joins) {
        layer.points = packed(floats_, weight.narrow(1, hidden, point), point, layer.columns);
        layer.code = weight.narrow(1, hidden + point, code).contiguous();
      }
      widest_ = std::max(widest_, layer.columns);
      layers_.push_back(std::move(layer));
    }
    last_weight_ = padded(plain(layers.back().first), options.out_dim, layers_.back().columns);
    last_bias_ = plain(layers.back().second);
  }

  FoldedCode fold(const at::Tensor& code) const override {
    const auto folded = [&](const Layer& layer) {
      const at::Tensor product = layer.code.mv(plain(code));
      std::vector<float> result = layer.bias;
      const float* added = product.const_data_ptr<float>();
      for (int64_t c = 0; c < product.numel(); ++c) result[static_cast<size_t>(c)] += added[c];
      return result;
    };
    return {folded(layers_.front()), folded(layers_[static_cast<size_t>(options_.skip_layer())])};
  }

  void run(const float* points, int64_t count, const FoldedCode& code,
           float* result) const override {
    std::unique_ptr<Work> work = idle_.take();
    if (!work) work = std::make_unique<Work>(static_cast<size_t>(kTile * widest_));
    for (int64_t first = 0; first < count; first += kTile) {
      run_tile(points + first * options_.point_dim, std::min(kTile, count - first), code, *work,
               result + first * options_.out_dim);
    }
    idle_.give(std::move(work));
  }

 private:
  struct Layer {
    int64_t rows = 0, columns = 0;  // padded
    std::vector<T> hidden;
    std::vector<float> points, bias;
    at::Tensor code;  // (out, code_dim)
  };
  struct Work {
    explicit Work(size_t size) : x(size), y(size), element(size) {}
    std::vector<float> x, y;
    std::vector<T> element;
  };

  /// result = points W + bias, coordinates in float32.
  void from_points(const Layer& layer, const float* points, int64_t rows,
                   const std::vector<float>& bias, float* result) const {
    const int64_t dim = options_.point_dim;
    const Segment<float> segment{points, dim, layer.points.data(), dim};
    floats_.product(&segment, 1, rows, layer.columns, {bias.data(), nullptr, false}, result,
                    nullptr, layer.columns);
  }

  void run_tile(const float* points, int64_t rows, const FoldedCode& code, Work& work,
                float* result) const {
    const auto beta = static_cast<float>(options_.beta);
    from_points(layers_.front(), points, rows, code.first, work.x.data());
    floats_.softplus(work.x.data(), rows * layers_.front().columns, beta);
    for (size_t index = 1; index < layers_.size(); ++index) {
      const Layer& layer = layers_[index];
      Epilogue epilogue;
      if (static_cast<int64_t>(index) == options_.skip_layer()) {
        from_points(layer, points, rows, code.skip, work.y.data());
        epilogue.residual = work.y.data();
      } else {
        epilogue.bias = layer.bias.data();
      }
      const T* element = nullptr;
      if constexpr (std::is_same_v<T, float>) {
        element = work.x.data();
      } else {
        kernels_.convert(work.x.data(), rows * layer.rows, work.element.data());
        element = work.element.data();
      }
      const Segment<T> segment{element, layer.rows, layer.hidden.data(), layer.rows};
      kernels_.product(&segment, 1, rows, layer.columns, epilogue, work.y.data(), nullptr,
                       layer.columns);
      floats_.softplus(work.y.data(), rows * layer.columns, beta);
      std::swap(work.x, work.y);
    }
    floats_.project(work.x.data(), rows, layers_.back().columns,
                    last_weight_.const_data_ptr<float>(), last_bias_.const_data_ptr<float>(),
                    options_.out_dim, result);
  }

  const Kernels<T>& kernels_;
  const Kernels<float>& floats_;
  FieldMlpOptions options_;
  int64_t widest_ = 0;
  std::vector<Layer> layers_;
  at::Tensor last_weight_, last_bias_;
  mutable core::WorkPool<Work> idle_;
};

}  // namespace

PackedFieldMlp::PackedFieldMlp(const FieldMlpOptions& options, const Layers& layers,
                               bool bfloat16) {
  const at::NoGradGuard no_grad;
  const Kernels<uint16_t>* half = bfloat16 ? kernels::bfloat16_kernels() : nullptr;
  if (half != nullptr) {
    engine_ = std::make_unique<PackedEngine<uint16_t>>(*half, options, layers);
  } else {
    engine_ = std::make_unique<PackedEngine<float>>(kernels::float_kernels(), options, layers);
  }
}

PackedFieldMlp::PackedFieldMlp(PackedFieldMlp&&) noexcept = default;
PackedFieldMlp::~PackedFieldMlp() = default;

FoldedCode PackedFieldMlp::fold(const at::Tensor& code) const { return engine_->fold(code); }

void PackedFieldMlp::run(const float* points, int64_t count, const FoldedCode& code,
                         float* result) const {
  engine_->run(points, count, code, result);
}

PackedFieldMlp::Layers layers_of(const FieldMlpImpl& network) {
  PackedFieldMlp::Layers result;
  for (const torch::nn::Linear& layer : network.layers()) {
    result.emplace_back(layer->weight, layer->bias);
  }
  return result;
}

std::vector<PackedFieldMlp::Layers> layers_of(const EnsembledFieldMlpImpl& ensemble) {
  std::vector<PackedFieldMlp::Layers> result(
      static_cast<size_t>(ensemble.layers().front()->weight.size(0)));
  for (const EnsembledLinear& layer : ensemble.layers()) {
    for (size_t network = 0; network < result.size(); ++network) {
      const auto n = static_cast<int64_t>(network);
      result[network].emplace_back(layer->weight[n], layer->bias[n]);
    }
  }
  return result;
}

}  // namespace freetalk::nn
