#include "freetalk/nn/fused_diffusion.h"

#include <ATen/Parallel.h>
#include <torch/torch.h>

#include <algorithm>
#include <type_traits>
#include <vector>

#include "freetalk/core/error.h"
#include "fused_kernels.h"

namespace freetalk::nn {

class FusedDiffusion::Engine {
 public:
  virtual ~Engine() = default;
  virtual at::Tensor run(const FrameInputs& inputs, int64_t num_frames, int64_t in_work) const = 0;
  virtual int64_t bytes_per_frame() const = 0;
};

namespace {

using fused::Epilogue;
using fused::kTile;
using fused::Segment;

constexpr int64_t kEigenBlock = 8;  // the accumulation kernel's rows
constexpr int64_t kMaxKeys = 128;   // the softmax kernel's work space

int64_t round_up(int64_t value, int64_t multiple) {
  return (value + multiple - 1) / multiple * multiple;
}

at::Tensor plain(const at::Tensor& x) { return x.detach().to(at::kFloat).contiguous(); }

/// (R, C) with zeros to (rows, columns).
at::Tensor padded(const at::Tensor& x, int64_t rows, int64_t columns) {
  at::Tensor result = at::zeros({rows, columns}, at::kFloat);
  result.narrow(0, 0, x.size(0)).narrow(1, 0, x.size(1)).copy_(x);
  return result;
}

template <class T>
class FusedEngine final : public FusedDiffusion::Engine {
 public:
  FusedEngine(const fused::Kernels<T>& kernels, DiffusionNetImpl& net,
              const geometry::SurfaceOperators& operators, const at::Tensor& base,
              const at::Tensor& queries)
      : kernels_(kernels),
        vertices_(operators.num_vertices()),
        width_(net.options().width),
        outputs_(net.options().out_channels),
        columns_(round_up(width_, kernels.panel)),
        modes_(round_up(operators.k_eig(), kEigenBlock)) {
    prepare_mesh(operators, base, queries);
    for (DiffusionNetBlock block : net.blocks()) prepare_block(*block, operators.evals);
    last_weight_ = padded(plain(net.last_lin->weight), outputs_, columns_);
    last_bias_ = plain(net.last_lin->bias);
  }

  at::Tensor run(const FrameInputs& inputs, int64_t num_frames, int64_t in_work) const override {
    at::Tensor result = at::empty({num_frames, vertices_, outputs_}, at::kFloat);
    const FrameInputs prepared{inputs.offsets.defined()
                                   ? padded(plain(inputs.offsets), num_frames, columns_)
                                   : at::zeros({num_frames, columns_}, at::kFloat),
                               inputs.keys.defined() ? plain(inputs.keys) : inputs.keys,
                               inputs.values.defined() ? plain(inputs.values) : inputs.values};
    const int64_t grain = (num_frames + in_work - 1) / in_work;
    at::parallel_for(0, num_frames, grain, [&](int64_t begin, int64_t end) {
      Work work(*this, prepared);
      for (int64_t frame = begin; frame < end; ++frame) {
        run_frame(prepared, frame, work, result.data_ptr<float>() + frame * vertices_ * outputs_);
      }
    });
    return result;
  }

  int64_t bytes_per_frame() const override {
    return (vertices_ + 12 * kTile + 5 * modes_) * columns_ * static_cast<int64_t>(sizeof(float));
  }

 private:
  struct Block {
    std::vector<T> a_re, a_im, minus_a_im, of_x, of_diffused, of_products, second, third;
    at::Tensor decay, bias[3];  // (modes, columns), (columns,)
  };

  /// A frame's state and a tile's.
  struct Work {
    std::vector<float> x, sums, spectrum, scores;
    std::vector<float> gx, gy, re, im;
    std::vector<T> packed, mixed, rows, element_x, element_y, z, first, second, grouped, weights;
    std::vector<std::vector<T>> keys, values;  // of each head, packed

    Work(const FusedEngine& e, const FrameInputs& inputs)
        : x(size(e.vertices_ * e.columns_)),
          sums(size(e.modes_ * e.columns_)),
          spectrum(sums.size()),
          gx(size(kTile * e.columns_)),
          gy(gx.size()),
          re(gx.size()),
          im(gx.size()),
          packed(sums.size()),
          mixed(sums.size()),
          rows(sums.size()),
          element_x(gx.size()),
          element_y(gx.size()),
          z(gx.size()),
          first(gx.size()),
          second(gx.size()),
          grouped(gx.size()) {
      if (!inputs.keys.defined()) return;
      const int64_t keys_padded = round_up(inputs.keys.size(2), e.kernels_.panel);
      scores.resize(size(kTile * keys_padded));
      weights.resize(scores.size());
      keys.assign(size(inputs.keys.size(1)), std::vector<T>(size(keys_padded * e.head_columns_)));
      values.assign(keys.size(), std::vector<T>(size(keys_padded * e.columns_)));
    }
    static size_t size(int64_t count) { return static_cast<size_t>(count); }
  };

  std::vector<T> rows_of(const at::Tensor& x) const {
    std::vector<T> result(static_cast<size_t>(round_up(x.numel(), 16)));
    const at::Tensor source =
        at::constant_pad_nd(x.reshape({-1}), {0, static_cast<int64_t>(result.size()) - x.numel()});
    kernels_.convert(source.const_data_ptr<float>(), source.numel(), result.data());
    return result;
  }

  /// A (out, in) weight as a packed right operand (in, out).
  std::vector<T> packed_weight(const at::Tensor& weight) const {
    const at::Tensor square = padded(plain(weight), columns_, columns_).t().contiguous();
    std::vector<T> result(static_cast<size_t>(square.numel()));
    kernels_.pack(square.const_data_ptr<float>(), columns_, columns_, result.data());
    return result;
  }

  void prepare_mesh(const geometry::SurfaceOperators& operators, const at::Tensor& base,
                    const at::Tensor& queries) {
    const at::Tensor evecs = plain(operators.evecs);
    const at::Tensor slopes = operators.gradients.matmul(evecs);  // (2V, K): G Phi
    basis_ = rows_of(padded(evecs, vertices_, modes_));
    basis_x_ = rows_of(padded(slopes.narrow(0, 0, vertices_), vertices_, modes_));
    basis_y_ = rows_of(padded(slopes.narrow(0, vertices_, vertices_), vertices_, modes_));
    const at::Tensor weighted =
        padded(evecs * operators.mass.unsqueeze(1), round_up(vertices_, 2), modes_);
    weighted_.resize(static_cast<size_t>(weighted.numel()));
    group_exact(weighted);
    base_ = padded(plain(base), vertices_, columns_);
    if (!queries.defined()) return;
    heads_ = queries.size(0);
    head_columns_ = round_up(queries.size(2), kernels_.group);
    for (int64_t head = 0; head < heads_; ++head) {
      queries_.push_back(rows_of(padded(plain(queries[head]), vertices_, head_columns_)));
    }
  }

  /// The mass-weighted basis, grouped; modes_ need not be a multiple of the vector.
  void group_exact(const at::Tensor& weighted) {
    const int64_t group = kernels_.group;
    const std::vector<T> rows = rows_of(weighted);
    for (int64_t v = 0; v < weighted.size(0); ++v) {
      for (int64_t k = 0; k < modes_; ++k) {
        weighted_[static_cast<size_t>(v / group * group * modes_ + k * group + v % group)] =
            rows[static_cast<size_t>(v * modes_ + k)];
      }
    }
  }

  void prepare_block(DiffusionNetBlockImpl& block, const at::Tensor& evals) {
    Block result;
    const at::Tensor time = plain(block.diffusion->time());
    result.decay =
        padded(at::exp(-plain(evals).unsqueeze(1) * time.unsqueeze(0)), modes_, columns_);
    const at::Tensor a_im = plain(block.gradient_features->a_im->weight);
    result.a_re = packed_weight(block.gradient_features->a_re->weight);
    result.a_im = packed_weight(a_im);
    result.minus_a_im = packed_weight(-a_im);
    const at::Tensor first = plain(block.mlp[0]->weight);
    result.of_x = packed_weight(first.narrow(1, 0, width_));
    result.of_diffused = packed_weight(first.narrow(1, width_, width_));
    result.of_products = packed_weight(first.narrow(1, 2 * width_, width_));
    result.second = packed_weight(block.mlp[1]->weight);
    result.third = packed_weight(block.mlp[2]->weight);
    for (size_t layer = 0; layer < 3; ++layer) {
      result.bias[layer] =
          padded(plain(block.mlp[layer]->bias).unsqueeze(0), 1, columns_).squeeze(0);
    }
    blocks_.push_back(std::move(result));
  }

  void run_frame(const FrameInputs& inputs, int64_t frame, Work& work, float* result) const {
    pack_heads(inputs, frame, work);
    std::fill(work.sums.begin(), work.sums.end(), 0.0F);
    for (int64_t v = 0; v < vertices_; v += kTile) {
      const int64_t rows = std::min(kTile, vertices_ - v);
      first_layer(inputs, frame, v, rows, work);
      add_to_spectrum(v, rows, work);
    }
    for (size_t index = 0; index < blocks_.size(); ++index) {
      const Block& block = blocks_[index];
      const bool last = index + 1 == blocks_.size();
      prepare_spectrum(block, work);
      std::fill(work.sums.begin(), work.sums.end(), 0.0F);
      for (int64_t v = 0; v < vertices_; v += kTile) {
        const int64_t rows = std::min(kTile, vertices_ - v);
        run_tile(block, v, rows, work);
        if (!last) add_to_spectrum(v, rows, work);
      }
    }
    kernels_.project(work.x.data(), vertices_, columns_,
                     last_weight_.template const_data_ptr<float>(),
                     last_bias_.template const_data_ptr<float>(), outputs_, result);
  }

  void pack_heads(const FrameInputs& inputs, int64_t frame, Work& work) const {
    if (!inputs.keys.defined()) return;
    const int64_t count = inputs.keys.size(2), columns = round_up(count, kernels_.panel);
    for (int64_t head = 0; head < heads_; ++head) {
      const at::Tensor keys = padded(inputs.keys[frame][head].t(), head_columns_, columns);
      kernels_.pack(keys.const_data_ptr<float>(), head_columns_, columns,
                    work.keys[static_cast<size_t>(head)].data());
      const at::Tensor values = padded(inputs.values[frame][head], count, columns_);
      kernels_.pack(values.const_data_ptr<float>(), count, columns_,
                    work.values[static_cast<size_t>(head)].data());
    }
  }

  /// x <- base + offset + attention.
  void first_layer(const FrameInputs& inputs, int64_t frame, int64_t v, int64_t rows,
                   Work& work) const {
    float* x = work.x.data() + v * columns_;
    Epilogue epilogue;
    epilogue.bias = inputs.offsets.const_data_ptr<float>() + frame * columns_;
    epilogue.residual = base_.const_data_ptr<float>() + v * columns_;
    if (!inputs.keys.defined()) {
      kernels_.product(nullptr, 0, rows, columns_, epilogue, x, nullptr, columns_);
      return;
    }
    const int64_t count = inputs.keys.size(2), stride = round_up(count, kernels_.panel);
    for (int64_t head = 0; head < heads_; ++head) {
      const size_t h = static_cast<size_t>(head);
      const Segment<T> of_keys{queries_[h].data() + v * head_columns_, head_columns_,
                               work.keys[h].data(), head_columns_};
      kernels_.product(&of_keys, 1, rows, stride, Epilogue{}, work.scores.data(), nullptr, stride);
      kernels_.softmax(work.scores.data(), rows, stride, count, work.weights.data());
      const Segment<T> of_values{work.weights.data(), stride, work.values[h].data(),
                                 round_up(count, kernels_.group)};
      kernels_.product(&of_values, 1, rows, columns_, epilogue, x, nullptr, columns_);
      epilogue = Epilogue{};
      epilogue.residual = x;
    }
  }

  /// sums += Phi^T M x over a tile.
  void add_to_spectrum(int64_t v, int64_t rows, Work& work) const {
    const float* x = work.x.data() + v * columns_;
    const T* operand = nullptr;
    if constexpr (std::is_same_v<T, float>) {
      operand = x;
    } else {
      kernels_.group_rows(x, rows, columns_, work.grouped.data());
      operand = work.grouped.data();
    }
    kernels_.accumulate(weighted_.data() + v * modes_, operand, rows, modes_, columns_,
                        work.sums.data());
  }

  /// From the sums: the decayed spectrum as a right operand, and its product with the diffused
  /// part of the MLP's first layer.
  void prepare_spectrum(const Block& block, Work& work) const {
    const float* decay = block.decay.template const_data_ptr<float>();
    for (size_t i = 0; i < work.sums.size(); ++i) work.spectrum[i] = work.sums[i] * decay[i];
    kernels_.pack(work.spectrum.data(), modes_, columns_, work.packed.data());
    kernels_.convert(work.spectrum.data(), modes_ * columns_, work.rows.data());
    const Segment<T> segment{work.rows.data(), columns_, block.of_diffused.data(), columns_};
    kernels_.product(&segment, 1, modes_, columns_, Epilogue{}, work.spectrum.data(), nullptr,
                     columns_);
    kernels_.pack(work.spectrum.data(), modes_, columns_, work.mixed.data());
  }

  /// One block on one tile.
  void run_tile(const Block& block, int64_t v, int64_t rows, Work& work) const {
    const int64_t n = columns_;
    const auto multiply = [&](std::initializer_list<Segment<T>> segments, const Epilogue& epilogue,
                              float* as_float, T* as_element) {
      kernels_.product(segments.begin(), static_cast<int64_t>(segments.size()), rows, n, epilogue,
                       as_float, as_element, n);
    };
    const auto bias = [&](size_t layer) {
      return block.bias[layer].template const_data_ptr<float>();
    };
    float* x = work.x.data() + v * n;
    T *gx = work.element_x.data(), *gy = work.element_y.data(), *element = work.z.data();
    if constexpr (std::is_same_v<T, float>) gx = work.gx.data(), gy = work.gy.data(), element = x;
    const int64_t at = v * modes_;
    multiply({{basis_x_.data() + at, modes_, work.packed.data(), modes_}}, {}, work.gx.data(), gx);
    multiply({{basis_y_.data() + at, modes_, work.packed.data(), modes_}}, {}, work.gy.data(), gy);
    multiply({{gx, n, block.a_re.data(), n}, {gy, n, block.minus_a_im.data(), n}}, {},
             work.re.data(), nullptr);
    multiply({{gy, n, block.a_re.data(), n}, {gx, n, block.a_im.data(), n}}, {}, work.im.data(),
             nullptr);
    kernels_.gradient_product(work.gx.data(), work.gy.data(), work.re.data(), work.im.data(),
                              rows * n, work.second.data());
    if constexpr (!std::is_same_v<T, float>) kernels_.convert(x, rows * n, element);
    multiply({{element, n, block.of_x.data(), n},
              {basis_.data() + at, modes_, work.mixed.data(), modes_},
              {work.second.data(), n, block.of_products.data(), n}},
             {bias(0), nullptr, true}, nullptr, work.first.data());
    multiply({{work.first.data(), n, block.second.data(), n}}, {bias(1), nullptr, true}, nullptr,
             work.second.data());
    multiply({{work.second.data(), n, block.third.data(), n}}, {bias(2), x, false}, x, nullptr);
  }

  const fused::Kernels<T>& kernels_;
  int64_t vertices_, width_, outputs_, columns_, modes_, heads_ = 0, head_columns_ = 0;
  std::vector<T> basis_, basis_x_, basis_y_, weighted_;
  std::vector<std::vector<T>> queries_;
  std::vector<Block> blocks_;
  at::Tensor base_, last_weight_, last_bias_;
};

bool all_float_on_cpu(DiffusionNetImpl& net, const geometry::SurfaceOperators& operators) {
  const auto fits = [](const at::Tensor& t) { return t.is_cpu() && t.scalar_type() == at::kFloat; };
  const auto parameters = net.parameters();
  return fits(operators.mass) && fits(operators.evecs) &&
         std::all_of(parameters.begin(), parameters.end(), fits);
}

}  // namespace

bool FusedDiffusion::supports(DiffusionNetImpl& net, const geometry::SurfaceOperators& operators) {
  const DiffusionNetOptions& options = net.options();
  const bool equal_widths =
      options.mlp_hidden.empty() ||
      options.mlp_hidden == std::vector<int64_t>{options.width, options.width};
  return options.diffusion_method == "spectral" && options.with_gradient_features &&
         options.with_gradient_rotations && equal_widths && options.outputs_at == "vertices" &&
         operators.offsets.empty() && !(net.is_training() && options.dropout > 0) &&
         all_float_on_cpu(net, operators);
}

bool FusedDiffusion::supports_bfloat16() { return fused::bfloat16_kernels() != nullptr; }

FusedDiffusion::FusedDiffusion(DiffusionNetImpl& net, const geometry::SurfaceOperators& operators,
                               const at::Tensor& base, const at::Tensor& queries, bool bfloat16) {
  FREETALK_CHECK(supports(net, operators),
                 "FusedDiffusion: this network or these operators need the general forward pass");
  if (bfloat16 && supports_bfloat16()) {
    engine_ = std::make_unique<FusedEngine<uint16_t>>(*fused::bfloat16_kernels(), net, operators,
                                                      base, queries);
  } else {
    engine_ =
        std::make_unique<FusedEngine<float>>(fused::float_kernels(), net, operators, base, queries);
  }
}

FusedDiffusion::~FusedDiffusion() = default;
FusedDiffusion::FusedDiffusion(FusedDiffusion&&) noexcept = default;
FusedDiffusion& FusedDiffusion::operator=(FusedDiffusion&&) noexcept = default;

at::Tensor FusedDiffusion::run(const FrameInputs& inputs, int64_t num_frames,
                               int64_t in_work) const {
  FREETALK_CHECK(num_frames > 0 && in_work > 0, "FusedDiffusion: frames must be positive, found ",
                 num_frames, " and ", in_work);
  FREETALK_CHECK(!inputs.keys.defined() || inputs.keys.size(2) <= kMaxKeys,
                 "FusedDiffusion: at most ", kMaxKeys, " keys, found ", inputs.keys.size(2));
  const torch::NoGradGuard no_grad;
  return engine_->run(inputs, num_frames, in_work);
}

int64_t FusedDiffusion::bytes_per_frame() const { return engine_->bytes_per_frame(); }

}  // namespace freetalk::nn
