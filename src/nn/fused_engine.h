// The decoder of fused_diffusion.h in one element type.
#pragma once

#include <torch/torch.h>

#include <algorithm>
#include <initializer_list>
#include <memory>
#include <type_traits>
#include <utility>
#include <vector>

#include "core/parallel.h"
#include "freetalk/nn/sparse.h"
#include "fused_layout.h"
#include "nn/fused_diffusion.h"

namespace freetalk::nn {

class FusedDiffusion::Engine {
 public:
  virtual ~Engine() = default;
  virtual at::Tensor run(const FrameInputs& inputs, int64_t num_frames, int64_t in_work) const = 0;
  virtual int64_t bytes_per_frame() const = 0;
};

namespace fused {

inline constexpr int64_t kEigenBlock = 8;  // the accumulation kernel's rows
inline constexpr int64_t kMaxKeys = 128;   // the softmax kernel's work space

template <class T>
class FusedEngine final : public FusedDiffusion::Engine {
 public:
  FusedEngine(const Kernels<T>& kernels, DiffusionNetImpl& net,
              const geometry::SurfaceOperators& operators, const FusedInput& input)
      : kernels_(kernels),
        vertices_(operators.num_vertices()),
        width_(net.options().width),
        outputs_(net.options().out_channels),
        columns_(round_up(width_, kernels.panel)),
        modes_(round_up(operators.k_eig(), kEigenBlock)) {
    prepare_mesh(operators);
    base_ = padded(plain(input.base), vertices_, columns_);
    if (input.queries.defined()) prepare_attention(input.queries, input.mixing);
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
    const int64_t workers = std::min({in_work, num_frames, core::num_threads()});
    std::vector<std::unique_ptr<Work>> work(static_cast<size_t>(workers));
    core::parallel_tasks(num_frames, workers, [&](int64_t frame, int64_t worker) {
      std::unique_ptr<Work>& own = work[static_cast<size_t>(worker)];
      if (!own) own = std::make_unique<Work>(*this);
      run_frame(prepared, frame, *own, result.data_ptr<float>() + frame * vertices_ * outputs_);
    });
    return result;
  }

  int64_t bytes_per_frame() const override {
    constexpr auto kFloat = static_cast<int64_t>(sizeof(float));
    return (vertices_ + 8 * kTile + 7 * modes_) * columns_ * kFloat;
  }

 private:
  struct Block {
    std::vector<T> a_re, a_im, of_x, of_diffused, of_products, second, third;
    at::Tensor decay, bias[3];  // (modes, columns), (columns,)
  };

  /// A frame's state, x, and a tile's.
  struct Work {
    std::vector<float> x, sums, spectrum, scores, fields;
    std::vector<T> packed[3], mixed, rows, z, element, first, second, grouped, weights, attended;
    std::vector<std::vector<T>> keys, values;  // of each head, packed

    explicit Work(const FusedEngine& e)
        : x(size(e.vertices_ * e.columns_)),
          sums(size(e.modes_ * e.columns_)),
          spectrum(sums.size()),
          fields(size(kTile * e.field_row())),
          mixed(sums.size()),
          rows(sums.size()),
          z(size(kTile * e.columns_)),
          element(size(kTile * e.columns_)),
          first(element.size()),
          second(element.size()),
          grouped(element.size()),
          attended(size(kTile * e.attended_row_)) {
      for (std::vector<T>& part : packed) part.resize(sums.size());
    }

    /// Room for attention to this many keys.
    void fit(const FusedEngine& e, int64_t keys_padded) {
      if (scores.size() == size(kTile * keys_padded)) return;
      scores.assign(size(kTile * keys_padded), 0.0F);
      weights.assign(scores.size(), T{});
      keys.assign(size(e.heads_), std::vector<T>(size(keys_padded * e.head_columns_)));
      values.assign(keys.size(), std::vector<T>(size(keys_padded * e.value_columns_)));
    }
    static size_t size(int64_t count) { return static_cast<size_t>(count); }
  };

  /// Gradients of what is diffused are those of the eigenvectors, times its spectrum: they are no
  /// differences of rounded neighbours, and a vertex needs no other.
  void prepare_mesh(const geometry::SurfaceOperators& operators) {
    const at::Tensor evecs = plain(operators.evecs);
    const at::Tensor weighted = evecs * plain(operators.mass).unsqueeze(1);
    basis_ = rows_of(kernels_, padded(evecs, vertices_, modes_));
    weighted_ = grouped_rows(kernels_, padded(weighted, round_up(vertices_, 2), modes_));
    const at::Tensor both = sparse_product(operators.gradients, evecs.unsqueeze(0))[0];  // (2 V, K)
    for (int64_t axis = 0; axis < 2; ++axis) {
      const at::Tensor gradient = both.narrow(0, axis * vertices_, vertices_);
      gradients_[axis] = rows_of(kernels_, padded(gradient, vertices_, modes_));
    }
  }

  /// Heads lie side by side in a row of what was attended to. A head's product ends with zeros up
  /// to a panel, which the next head overwrites.
  void prepare_attention(const at::Tensor& queries, const at::Tensor& mixing) {
    const at::Tensor weight = plain(mixing).t();
    heads_ = queries.size(0);
    head_columns_ = round_up(queries.size(2), kernels_.group);
    head_width_ = weight.size(0) / heads_;
    value_columns_ = round_up(head_width_, kernels_.panel);
    attended_row_ = round_up((heads_ - 1) * head_width_ + value_columns_, kernels_.group);
    mixing_.resize(static_cast<size_t>(attended_columns() * columns_));
    const at::Tensor whole = padded(weight, attended_columns(), columns_);
    kernels_.pack(whole.const_data_ptr<float>(), attended_columns(), columns_, mixing_.data());
    for (int64_t head = 0; head < heads_; ++head) {
      queries_.push_back(rows_of(kernels_, padded(plain(queries[head]), vertices_, head_columns_)));
    }
  }

  void prepare_block(DiffusionNetBlockImpl& block, const at::Tensor& evals) {
    Block result;
    const at::Tensor time = plain(block.diffusion->time());
    result.decay =
        padded(at::exp(-plain(evals).unsqueeze(1) * time.unsqueeze(0)), modes_, columns_);
    result.a_re = packed_weight(kernels_, block.gradient_features->a_re->weight, columns_);
    result.a_im = packed_weight(kernels_, block.gradient_features->a_im->weight, columns_);
    const at::Tensor first = plain(block.mlp[0]->weight);
    result.of_x = packed_weight(kernels_, first.narrow(1, 0, width_), columns_);
    result.of_diffused = packed_weight(kernels_, first.narrow(1, width_, width_), columns_);
    result.of_products = packed_weight(kernels_, first.narrow(1, 2 * width_, width_), columns_);
    result.second = packed_weight(kernels_, block.mlp[1]->weight, columns_);
    result.third = packed_weight(kernels_, block.mlp[2]->weight, columns_);
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
    project(work, result);
  }

  /// The last layer.
  void project(Work& work, float* result) const {
    for (int64_t v = 0; v < vertices_; v += kTile) {
      kernels_.project(work.x.data() + v * columns_, std::min(kTile, vertices_ - v), columns_,
                       last_weight_.template const_data_ptr<float>(),
                       last_bias_.template const_data_ptr<float>(), outputs_,
                       result + v * outputs_);
    }
  }

  void pack_heads(const FrameInputs& inputs, int64_t frame, Work& work) const {
    if (!inputs.keys.defined()) return;
    const int64_t count = inputs.keys.size(2), columns = round_up(count, kernels_.panel);
    work.fit(*this, columns);
    for (int64_t head = 0; head < heads_; ++head) {
      const at::Tensor keys = padded(inputs.keys[frame][head].t(), head_columns_, columns);
      kernels_.pack(keys.const_data_ptr<float>(), head_columns_, columns,
                    work.keys[static_cast<size_t>(head)].data());
      const at::Tensor values = padded(inputs.values[frame][head], count, value_columns_);
      kernels_.pack(values.const_data_ptr<float>(), count, value_columns_,
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
      kernels_.product(&of_values, 1, rows, value_columns_, Epilogue{}, nullptr,
                       work.attended.data() + head * head_width_, attended_row_);
    }
    const Segment<T> of_heads{work.attended.data(), attended_row_, mixing_.data(),
                              attended_columns()};
    kernels_.product(&of_heads, 1, rows, columns_, epilogue, x, nullptr, columns_);
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

  /// From the sums: the decayed spectrum s, s A_re, s A_im, and its product with the diffused part
  /// of the MLP's first layer, as right operands.
  void prepare_spectrum(const Block& block, Work& work) const {
    const float* decay = block.decay.template const_data_ptr<float>();
    for (size_t i = 0; i < work.sums.size(); ++i) work.spectrum[i] = work.sums[i] * decay[i];
    kernels_.pack(work.spectrum.data(), modes_, columns_, work.packed[0].data());
    kernels_.convert(work.spectrum.data(), modes_ * columns_, work.rows.data());
    const auto times = [&](const std::vector<T>& weight, std::vector<T>& result) {
      const Segment<T> segment{work.rows.data(), columns_, weight.data(), columns_};
      kernels_.product(&segment, 1, modes_, columns_, Epilogue{}, work.spectrum.data(), nullptr,
                       columns_);
      kernels_.pack(work.spectrum.data(), modes_, columns_, result.data());
    };
    times(block.a_re, work.packed[1]);
    times(block.a_im, work.packed[2]);
    times(block.of_diffused, work.mixed);
  }

  /// z of a tile, a panel of columns at a time: gradients of what is diffused, of it times A_re
  /// and of it times A_im.
  void gradient_features(int64_t v, int64_t rows, Work& work) const {
    const int64_t panel = kernels_.panel, stride = field_row();
    for (int64_t first = 0; first < columns_; first += panel) {
      float* field = work.fields.data();
      for (const std::vector<T>& gradient : gradients_) {
        for (const std::vector<T>& part : work.packed) {
          const Segment<T> segment{gradient.data() + v * modes_, modes_,
                                   part.data() + first * modes_, modes_};
          kernels_.product(&segment, 1, rows, panel, Epilogue{}, field, nullptr, stride);
          field += panel;
        }
      }
      kernels_.gradient_features(rows, work.fields.data(), work.z.data() + first, columns_);
    }
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
    gradient_features(v, rows, work);
    float* x = work.x.data() + v * n;
    const T* element = nullptr;
    if constexpr (std::is_same_v<T, float>) {
      element = x;
    } else {
      kernels_.convert(x, rows * n, work.element.data());
      element = work.element.data();
    }
    multiply({{element, n, block.of_x.data(), n},
              {basis_.data() + v * modes_, modes_, work.mixed.data(), modes_},
              {work.z.data(), n, block.of_products.data(), n}},
             {bias(0), nullptr, true}, nullptr, work.first.data());
    multiply({{work.first.data(), n, block.second.data(), n}}, {bias(1), nullptr, true}, nullptr,
             work.second.data());
    multiply({{work.second.data(), n, block.third.data(), n}}, {bias(2), x, false}, x, nullptr);
  }

  int64_t attended_columns() const { return round_up(heads_ * head_width_, kernels_.group); }
  /// Floats of a vertex's fields.
  int64_t field_row() const { return 6 * kernels_.panel; }

  const Kernels<T>& kernels_;
  int64_t vertices_, width_, outputs_, columns_, modes_, heads_ = 0, head_columns_ = 0;
  int64_t head_width_ = 0, value_columns_ = 0, attended_row_ = 0;
  std::vector<T> basis_, gradients_[2], weighted_, mixing_;
  std::vector<std::vector<T>> queries_;
  std::vector<Block> blocks_;
  at::Tensor base_, last_weight_, last_bias_;
};

}  // namespace fused
}  // namespace freetalk::nn
