#include "head/adam_fit.h"

#include <torch/torch.h>

#include <algorithm>

#include "head/fit_residuals.h"

namespace freetalk::head {
namespace {

/// Eq. 16 of a window. @param before the code of the frame before it, kept; undefined: none.
at::Tensor window_loss(ParametricHeadImpl& head, const at::Tensor& z_id,
                       const std::vector<at::Tensor>& points, const at::Tensor& codes,
                       const at::Tensor& before, const FitOptions& options) {
  const int64_t frames = codes.size(0);
  at::Tensor distance = at::zeros({}, codes.options());
  for (int64_t t = 0; t < frames; ++t) {
    const at::Tensor s = head.forward(points[static_cast<size_t>(t)].unsqueeze(0),
                                      z_id.unsqueeze(0), codes[t].unsqueeze(0));
    distance = distance + s.abs().mean();
  }
  const at::Tensor chain = before.defined() ? at::cat({before, codes}) : codes;
  const int64_t pairs = chain.size(0) - 1;
  at::Tensor temporal = at::zeros({}, codes.options());
  if (pairs > 0) {
    temporal =
        at::huber_loss(chain.narrow(0, 1, pairs), chain.narrow(0, 0, pairs), at::Reduction::Sum);
  }
  const at::Tensor size = codes.square().sum();
  return options.lambda_sdf * distance + options.lambda_temp * temporal + options.lambda_reg * size;
}

}  // namespace

at::Tensor adam_expressions(ParametricHeadImpl& head, const at::Tensor& z_id,
                            const std::vector<at::Tensor>& points, const at::Tensor& start,
                            const FitOptions& options, at::Generator& generator,
                            const FitCallback& on_step) {
  const auto frames = static_cast<int64_t>(points.size());
  const double scale = head.options().units_per_metre;
  at::Tensor result = start.clone();
  const int64_t stride = options.window - options.overlap;
  const int64_t windows = std::max<int64_t>(1, (frames - options.overlap + stride - 1) / stride);
  for (int64_t window = 0; window < windows; ++window) {
    // The frames that a window shares with the one before stay as that one found them.
    const int64_t begin = window == 0 ? 0 : window * stride + options.overlap;
    const int64_t end = std::min(frames, window * stride + options.window);
    const at::AutoGradMode recording(true);
    const at::Tensor codes = result.narrow(0, begin, end - begin).clone().requires_grad_();
    const at::Tensor before = begin > 0 ? result.narrow(0, begin - 1, 1).clone() : at::Tensor();
    torch::optim::Adam adam({codes}, torch::optim::AdamOptions(options.learning_rate));
    for (int64_t step = 0; step < options.adam_iterations; ++step) {
      if (step == options.adam_decay) {
        static_cast<torch::optim::AdamOptions&>(adam.param_groups()[0].options())
            .lr(options.learning_rate / 10);
      }
      std::vector<at::Tensor> drawn;
      for (int64_t t = begin; t < end; ++t) {
        drawn.push_back(
            draw_points(points[static_cast<size_t>(t)], options.adam_points, scale, generator));
      }
      const at::Tensor loss = window_loss(head, z_id, drawn, codes, before, options);
      codes.mutable_grad() = torch::autograd::grad({loss}, {codes})[0];
      adam.step();
      if (on_step) {
        on_step(window * options.adam_iterations + step + 1, windows * options.adam_iterations);
      }
    }
    result.narrow(0, begin, end - begin).copy_(codes.detach());
  }
  return result;
}

}  // namespace freetalk::head
