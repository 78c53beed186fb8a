#include "freetalk/nn/causal_attention.h"

#include <algorithm>
#include <cmath>

#include "freetalk/core/error.h"

namespace freetalk::nn {
namespace {

/// Turns the pairs (j, j + d_head / 2) of channels by the angle of their frame.
at::Tensor rotated(const at::Tensor& x, const CausalSpan& span) {
  if (!span.cosines.defined()) return x;
  const auto halves = x.chunk(2, -1);
  const at::Tensor turned = at::cat({-halves[1], halves[0]}, -1);
  return x * span.cosines.to(x.scalar_type()) + turned * span.sines.to(x.scalar_type());
}

}  // namespace

CausalSpan causal_span(int64_t first, int64_t num_frames, int64_t window, int64_t head_dim,
                       bool rotary, const at::TensorOptions& options) {
  FREETALK_CHECK(first >= 0 && num_frames > 0, "causal_span: no piece of ", num_frames,
                 " frames begins at frame ", first);
  FREETALK_CHECK(window >= 0, "causal_span: window must not be negative, found ", window);
  const int64_t before = window > 0 ? std::min(window - 1, first) : first;
  const auto whole = options.dtype(at::kLong);
  const at::Tensor query = at::arange(first, first + num_frames, whole);
  const at::Tensor key = at::arange(first - before, first + num_frames, whole);
  const at::Tensor distance = query.unsqueeze(1) - key.unsqueeze(0);  // (T, P + T)
  CausalSpan span;
  span.allowed = distance >= 0;
  if (window > 0) span.allowed = span.allowed.logical_and(distance < window);
  if (rotary) {
    FREETALK_CHECK(head_dim % 2 == 0, "rotary positions need an even number of channels a head, ",
                   "found ", head_dim);
    // In double: the angles of late frames keep their digits.
    const int64_t half = head_dim / 2;
    const at::Tensor frequencies = at::exp(at::arange(half, options.dtype(at::kDouble)) *
                                           (-std::log(10000.0) / static_cast<double>(half)));
    const at::Tensor angles =
        (query.to(at::kDouble).unsqueeze(1) * frequencies).repeat({1, 2});  // (T, d_head)
    span.cosines = angles.cos().to(at::kFloat);
    span.sines = angles.sin().to(at::kFloat);
  }
  return span;
}

at::Tensor CausalAttentionImpl::forward(const at::Tensor& x, const CausalSpan& span, int64_t window,
                                        PastFrames* past) {
  const at::Tensor qkv = at::linear(x, in_proj_weight, in_proj_bias)
                             .unflatten(-1, {3, num_heads(), x.size(-1) / num_heads()})
                             .permute({2, 0, 3, 1, 4});  // (3, B, heads, T, d_head)
  const at::Tensor query = rotated(qkv[0], span);
  at::Tensor keys = rotated(qkv[1], span), values = qkv[2];
  if (past != nullptr) {
    if (past->keys.defined()) {
      keys = at::cat({past->keys, keys}, 2);
      values = at::cat({past->values, values}, 2);
    }
    const int64_t leave = window > 0 ? std::max<int64_t>(0, keys.size(2) - (window - 1)) : 0;
    past->keys = keys.slice(2, leave).clone();
    past->values = values.slice(2, leave).clone();
  }
  return attended(query, keys, values, span.allowed);
}

}  // namespace freetalk::nn
