#include "freetalk/nn/film.h"

#include <torch/nn/init.h>

#include <cmath>

#include "freetalk/core/error.h"

namespace freetalk::nn {

namespace {

constexpr int64_t kSqueeze =
    4;  // channels of squeeze_excite are d / 4 [Hu et al. 2018: 16 of 2048]

}  // namespace

void FilmLayerOptions::check() const {
  transformer.check();
  FREETALK_CHECK(
      condition == "film" || condition == "scale_shift" || condition == "squeeze_excite" ||
          condition == "dot_product" || condition == "input",
      "condition must be film, scale_shift, squeeze_excite, dot_product or input, found '",
      condition, "'");
  FREETALK_CHECK(film_form == "residual" || film_form == "plain",
                 "film_form must be residual or plain, found '", film_form, "'");
  FREETALK_CHECK(window >= 0, "window must not be negative, found ", window);
}

FilmPlaceImpl::FilmPlaceImpl(int64_t d_model, const FilmLayerOptions& options) : options_(options) {
  const std::string& kind = options.condition;
  if (kind == "squeeze_excite") {
    const int64_t squeezed = std::max<int64_t>(1, d_model / kSqueeze);
    squeeze_ = register_module("squeeze", torch::nn::Linear(d_model, squeezed));
    linear_ = register_module("linear", torch::nn::Linear(squeezed, d_model));
    return;
  }
  linear_ = register_module("linear", torch::nn::Linear(d_model, 2 * d_model));
  if (kind == "dot_product") {
    query_ = register_module("query", torch::nn::Linear(d_model, d_model));
  } else if (kind == "film" && options.film_form == "plain") {
    const torch::NoGradGuard no_grad;
    linear_->bias.narrow(0, 0, d_model).fill_(1.0);
  }
}

at::Tensor FilmPlaceImpl::terms(const at::Tensor& code) {
  if (options_.condition == "film") return linear_(at::mish(code));
  if (options_.condition == "squeeze_excite") {
    return linear_(at::relu(squeeze_(code))).sigmoid();
  }
  return linear_(code);
}

at::Tensor FilmPlaceImpl::forward(const at::Tensor& x, const at::Tensor& y,
                                  const at::Tensor& terms) {
  if (options_.condition == "squeeze_excite") return x + y * terms.unsqueeze(1);
  const auto halves = terms.unsqueeze(1).chunk(2, -1);  // (B, 1, d) each
  if (options_.condition == "dot_product") {
    const at::Tensor query = query_(y);
    const at::Tensor own = (query * y).sum(-1, true), told = (query * halves[0]).sum(-1, true);
    const at::Tensor share = ((told - own) / std::sqrt(static_cast<double>(y.size(-1)))).sigmoid();
    return x + y + share * (halves[1] - y);
  }
  if (options_.condition == "scale_shift") return (x + y) * (1 + halves[0]) + halves[1];
  if (options_.film_form == "plain") return (x + y) * halves[0] + halves[1];
  return x + y * (1 + halves[0]) + halves[1];
}

FilmDecoderLayerImpl::FilmDecoderLayerImpl(const FilmLayerOptions& options) : options_(options) {
  options.check();
  const TransformerLayerOptions& o = options.transformer;
  const int64_t d = o.d_model;
  self_attn_ = register_module("self_attn", CausalAttention(d, o.num_heads, o.dropout));
  if (options.aligned) {
    value_ = register_module("value", torch::nn::Linear(d, d));
    audio_out_ = register_module("audio_out", torch::nn::Linear(d, d));
  } else {
    multihead_attn_ =
        register_module("multihead_attn", MultiheadAttention(d, o.num_heads, o.dropout));
  }
  linear1_ = register_module("linear1", torch::nn::Linear(d, o.ff_dim));
  linear2_ = register_module("linear2", torch::nn::Linear(o.ff_dim, d));
  const torch::nn::LayerNormOptions norm({d});
  norm1_ = register_module("norm1", torch::nn::LayerNorm(norm));
  // What is heard at a frame itself does not depend on the frame's state: nothing to normalise.
  if (!options.aligned || !o.norm_first) {
    norm2_ = register_module("norm2", torch::nn::LayerNorm(norm));
  }
  norm3_ = register_module("norm3", torch::nn::LayerNorm(norm));
  dropout_ = register_module("dropout", torch::nn::Dropout(o.dropout));
  const int count = options.condition == "input" ? 0 : options.condition == "scale_shift" ? 1 : 3;
  for (int place = 0; place < count; ++place) {
    places_.push_back(register_module("film" + std::to_string(place + 1), FilmPlace(d, options)));
  }
}

PlaceTerms FilmDecoderLayerImpl::terms(const at::Tensor& code) {
  PlaceTerms result;
  for (size_t place = 0; place < places_.size(); ++place)
    result[place] = places_[place]->terms(code);
  for (size_t place = 1; place < result.size() && places_.size() == 1; ++place) {
    result[place] = result[0];
  }
  return result;
}

at::Tensor FilmDecoderLayerImpl::heard(const at::Tensor& memory) {
  return options_.aligned ? audio_out_(value_(memory)) : memory;
}

at::Tensor FilmDecoderLayerImpl::placed(size_t place, const at::Tensor& x, const at::Tensor& y,
                                        const PlaceTerms& terms) {
  const at::Tensor dropped = dropout_(y);
  if (places_.empty()) return x + dropped;
  return places_[places_.size() == 1 ? 0 : place](x, dropped, terms[place]);
}

at::Tensor FilmDecoderLayerImpl::forward(const at::Tensor& x, const at::Tensor& heard,
                                         const at::Tensor& heard_valid, const PlaceTerms& terms,
                                         const CausalSpan& span, PastFrames* past) {
  const bool first = options_.transformer.norm_first;
  const auto before = [&](torch::nn::LayerNorm& norm, const at::Tensor& y) {
    return first ? norm(y) : y;
  };
  const auto after = [&](torch::nn::LayerNorm& norm, const at::Tensor& y) {
    return first ? y : norm(y);
  };
  at::Tensor y = after(
      norm1_, placed(0, x, self_attn_(before(norm1_, x), span, options_.window, past), terms));
  const at::Tensor crossed =
      options_.aligned ? heard : multihead_attn_(before(norm2_, y), heard, heard_valid);
  y = after(norm2_, placed(1, y, crossed, terms));
  const at::Tensor active = options_.transformer.activated(linear1_(before(norm3_, y)));
  return after(norm3_, placed(2, y, linear2_(dropout_(active)), terms));
}

}  // namespace freetalk::nn
