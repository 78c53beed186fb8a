#include "freetalk/head/fit.h"

#include <torch/torch.h>

#include <algorithm>
#include <cmath>

#include "freetalk/core/error.h"
#include "freetalk/core/torch_error.h"
#include "head/adam_fit.h"
#include "head/fit_residuals.h"

namespace freetalk::head {
namespace {

constexpr int kHalvings = 3;           // of a step that made things worse
constexpr double kDamping = 1e-6;      // of a system's mean diagonal
constexpr double kWeightSpread = 0.2;  // of expression weights about their prior
constexpr double kUnmapped =
    0.1;  // spread of codes that no weights give, relative to those they do
constexpr double kMadToSpread = 1.4826;  // of a normal distribution

/// A frame's share of the normal equations, in double.
struct Frame {
  at::Tensor matrix, vector;   // (C, C), (C,)
  double cost = 0, error = 0;  // the robust mean; the mean |s| in head units
};

/// The points' spread about the surface, mm: that of most of them, if above sigma_mm.
double spread_mm(const std::vector<Linearized>& rows, const FitOptions& options,
                 double units_per_metre) {
  std::vector<at::Tensor> sizes;
  for (const Linearized& own : rows) sizes.push_back(own.distance.abs());
  const double typical = at::cat(sizes).median().item<double>() / units_per_metre * 1e3;
  return std::max(options.sigma_mm, kMadToSpread * typical);
}

/// mean_p rho(s / sigma), linearised: Huber's loss by reweighting.
Frame normal_equations(const Linearized& rows, const FitOptions& options, double sigma_mm,
                       double units_per_metre) {
  const double sigma = sigma_mm * 1e-3 * units_per_metre;
  const double bend = options.huber_mm / options.sigma_mm;
  const at::Tensor r = rows.distance.to(at::kDouble) / sigma;
  const at::Tensor size = r.abs();
  const at::Tensor weight = bend / size.clamp_min(bend) / static_cast<double>(r.size(0));
  const at::Tensor jacobian = rows.jacobian.to(at::kDouble) / sigma;
  const at::Tensor weighted = jacobian * weight.unsqueeze(1);
  const at::Tensor cost =
      at::where(size <= bend, size.square() / 2, bend * (size - bend / 2)).mean();
  return {weighted.t().mm(jacobian), weighted.t().mv(r), cost.item<double>(),
          rows.distance.abs().mean().item<double>()};
}

/// Solves D_t x_t - e (x_t-1 + x_t+1) = b_t by block elimination. @param diagonal T of (C, C),
/// positive definite; overwritten. @param right (T, C), likewise.
at::Tensor solve_chain(std::vector<at::Tensor>& diagonal, at::Tensor right, double e) {
  const auto frames = static_cast<int64_t>(diagonal.size());
  std::vector<at::Tensor> factors;
  for (int64_t t = 0; t < frames; ++t) {
    at::Tensor& own = diagonal[static_cast<size_t>(t)];
    if (t > 0 && e > 0) {
      const at::Tensor& before = factors.back();
      own = own - e * e * at::cholesky_inverse(before);
      right[t].add_(at::cholesky_solve(right[t - 1].unsqueeze(1), before).squeeze(1), e);
    }
    factors.push_back(at::linalg_cholesky(own));
  }
  for (int64_t t = frames - 1; t >= 0; --t) {
    if (t + 1 < frames && e > 0) right[t].add_(right[t + 1], e);
    right[t].copy_(
        at::cholesky_solve(right[t].unsqueeze(1), factors[static_cast<size_t>(t)]).squeeze(1));
  }
  return right;
}

void add_to_diagonal(at::Tensor matrix, double value) { matrix.diagonal().add_(value); }

double damping(const at::Tensor& matrix) {
  return kDamping * matrix.diagonal().mean().item<double>() + 1e-12;
}

/// The steps of all frames' expressions.
at::Tensor expression_steps(const std::vector<Frame>& frames, const at::Tensor& codes,
                            const at::Tensor& prior, const FitOptions& options) {
  const auto count = static_cast<int64_t>(frames.size());
  const at::Tensor z = codes.to(at::kDouble);
  at::Tensor right = -2 * options.prior * (z - prior.to(at::kDouble));
  const double e = 2 * options.temporal;
  if (count > 1 && e > 0) {
    const at::Tensor change = e * (z.narrow(0, 1, count - 1) - z.narrow(0, 0, count - 1));
    right.narrow(0, 0, count - 1).add_(change);
    right.narrow(0, 1, count - 1).sub_(change);
  }
  std::vector<at::Tensor> diagonal;
  for (int64_t t = 0; t < count; ++t) {
    const Frame& frame = frames[static_cast<size_t>(t)];
    diagonal.push_back(frame.matrix.clone());
    const int64_t neighbours = count > 1 ? (t > 0) + (t + 1 < count) : 0;
    add_to_diagonal(diagonal.back(), 2 * options.prior + e * static_cast<double>(neighbours) +
                                         damping(frame.matrix));
    right[t].sub_(frame.vector);
  }
  return solve_chain(diagonal, right, count > 1 ? e : 0);
}

double mean_error(const std::vector<Frame>& frames) {
  double sum = 0;
  for (const Frame& frame : frames) sum += frame.error;
  return sum / static_cast<double>(frames.size());
}

/// What is minimised, of expressions.
double objective(const std::vector<Frame>& frames, const at::Tensor& codes, const at::Tensor& prior,
                 const FitOptions& options) {
  double sum = options.prior * (codes - prior).square().sum().item<double>();
  const int64_t pairs = codes.size(0) - 1;
  if (pairs > 0) {
    const at::Tensor change = codes.narrow(0, 1, pairs) - codes.narrow(0, 0, pairs);
    sum += options.temporal * change.square().sum().item<double>();
  }
  for (const Frame& frame : frames) sum += frame.cost;
  return sum;
}

at::Tensor errors_mm(const std::vector<Frame>& frames, double units_per_metre) {
  std::vector<double> errors;
  for (const Frame& frame : frames) errors.push_back(frame.error / units_per_metre * 1e3);
  return at::tensor(errors, at::kDouble).to(at::kFloat);
}

at::Tensor codes_or(const at::Tensor& codes, const at::Tensor& otherwise, int64_t frames,
                    const char* name) {
  if (!codes.defined()) return otherwise.detach().unsqueeze(0).repeat({frames, 1});
  FREETALK_CHECK(codes.dim() == 2 && codes.size(0) == frames && codes.size(1) == otherwise.size(0),
                 "fit: expected ", name, " (", frames, ", ", otherwise.size(0), "), found ",
                 codes.sizes());
  FREETALK_CHECK(codes.isfinite().all().item<bool>(), "fit: ", name,
                 " holds numbers that are not finite");
  return codes.detach().to(at::kFloat).clone();
}

std::vector<at::Tensor> drawn(const std::vector<at::Tensor>& points, int64_t count, double scale,
                              at::Generator& generator) {
  check_frames(points);
  std::vector<at::Tensor> result;
  for (const at::Tensor& own : points) {
    result.push_back(draw_points(own, count, scale, generator));
  }
  return result;
}

/// What expressions are sought in: y of z = L y, whose L L' is how the codes of expression weights
/// vary about the face at rest; z itself where the head has no map of weights.
struct ExpressionSpace {
  explicit ExpressionSpace(ParametricHeadImpl& head) {
    const at::NoGradGuard no_grad;
    const int64_t dim = head.options().expression_dim, weights = head.options().num_weights;
    basis = at::eye(dim, at::kDouble);
    if (weights > 0) {
      const at::Tensor moved = head.expression_code(at::eye(weights, at::kFloat)) -
                               head.expression_code(at::zeros({1, weights}, at::kFloat));
      const at::Tensor rows = kWeightSpread * moved.to(at::kDouble);  // (W, Z)
      at::Tensor covariance = rows.t().mm(rows);
      add_to_diagonal(covariance,
                      kUnmapped * kUnmapped * covariance.diagonal().mean().item<double>() + 1e-12);
      basis = at::linalg_cholesky(covariance);
    }
  }
  at::Tensor codes(const at::Tensor& y) const {
    return y.to(at::kDouble).mm(basis.t()).to(at::kFloat);
  }
  at::Tensor coordinates(const at::Tensor& codes) const {
    return at::linalg_solve_triangular(basis, codes.to(at::kDouble).t(), false).t().contiguous();
  }

  at::Tensor basis;  // (Z, Z) double, lower triangular
};

Fit gauss_newton(ParametricHeadImpl& head, const at::Tensor& z_id,
                 const std::vector<at::Tensor>& points, const at::Tensor& prior,
                 const FitOptions& options, const FitCallback& on_step) {
  const double scale = head.options().units_per_metre;
  const ExpressionSpace space(head);
  const at::Tensor slope = space.basis.to(at::kFloat);
  const auto linearized = [&](size_t t, const at::Tensor& y) {
    Linearized rows = linearize_expression(head, points[t], z_id, space.codes(y.unsqueeze(0))[0]);
    rows.jacobian = rows.jacobian.mm(slope);
    return rows;
  };
  const at::Tensor usual = space.coordinates(prior);
  at::Tensor found = usual.clone();
  std::vector<Linearized> rows;
  std::vector<Frame> frames(points.size());
  for (size_t t = 0; t < points.size(); ++t) {
    rows.push_back(linearized(t, found[static_cast<int64_t>(t)]));
  }
  for (int64_t iteration = 0; iteration < options.iterations; ++iteration) {
    const double sigma_mm = spread_mm(rows, options, scale);
    for (size_t t = 0; t < points.size(); ++t) {
      frames[t] = normal_equations(rows[t], options, sigma_mm, scale);
    }
    const at::Tensor before = found;
    found = found + expression_steps(frames, found, usual, options);
    std::vector<Frame> next(points.size());
    const auto evaluate = [&](size_t t) {
      rows[t] = linearized(t, found[static_cast<int64_t>(t)]);
      next[t] = normal_equations(rows[t], options, sigma_mm, scale);
    };
    for (size_t t = 0; t < points.size(); ++t) evaluate(t);
    const double aim = objective(frames, before, usual, options);
    for (int halving = 0; halving < kHalvings && objective(next, found, usual, options) > aim;
         ++halving) {  // the frames that came out worse go half the way
      for (size_t t = 0; t < next.size(); ++t) {
        if (next[t].cost <= frames[t].cost) continue;
        const auto frame = static_cast<int64_t>(t);
        found[frame].add_(before[frame]).div_(2);
        evaluate(t);
      }
    }
    const double gain = (mean_error(frames) - mean_error(next)) / scale * 1e3;
    frames = std::move(next);
    if (on_step) on_step(iteration + 1, options.iterations);
    if (std::abs(gain) < options.tolerance_mm) break;
  }
  return {z_id.clone(), space.codes(found), errors_mm(frames, scale)};
}

/// What the identity is sought in: coefficients of identity_map about 0, or its code in units of
/// identity_scale about identity_mean.
struct IdentitySpace {
  explicit IdentitySpace(ParametricHeadImpl& head, const at::Tensor& start) {
    const at::NoGradGuard no_grad;
    if (head.options().num_coefficients > 0) {
      const at::Tensor units = at::eye(head.options().num_coefficients, at::kFloat);
      basis = head.identity_code(units).t().contiguous();  // (D, C)
      origin = at::zeros({basis.size(0)}, at::kFloat);
    } else {
      basis = at::diag(head.identity_scale);
      origin = head.identity_mean.clone();
    }
    coordinates = at::zeros({basis.size(1)}, at::kFloat);
    if (start.defined()) {
      coordinates = std::get<0>(at::linalg_lstsq(basis, (start - origin).unsqueeze(1))).squeeze(1);
    }
  }
  at::Tensor code(const at::Tensor& u) const { return origin + basis.mv(u); }

  at::Tensor basis, origin, coordinates;
};

/// The step of [u | y_1 | ... | y_T]: one dense system, whose frames meet in the identity.
at::Tensor joint_step(const std::vector<Frame>& frames, const IdentitySpace& space,
                      const at::Tensor& u, const at::Tensor& codes, const at::Tensor& prior,
                      const FitOptions& options) {
  const int64_t shared = u.size(0), own = codes.size(1), count = codes.size(0);
  const at::Tensor basis = space.basis.to(at::kDouble);
  const int64_t dim = basis.size(0);
  at::Tensor matrix = at::zeros({shared + count * own, shared + count * own}, at::kDouble);
  at::Tensor right = at::zeros({matrix.size(0)}, at::kDouble);
  for (int64_t t = 0; t < count; ++t) {
    const Frame& frame = frames[static_cast<size_t>(t)];
    const int64_t first = shared + t * own;
    const auto part = [&](int64_t a, int64_t rows, int64_t b, int64_t columns) {
      return matrix.narrow(0, a, rows).narrow(1, b, columns);
    };
    const at::Tensor of_identity = frame.matrix.narrow(0, 0, dim).narrow(1, 0, dim);
    const at::Tensor cross = frame.matrix.narrow(0, 0, dim).narrow(1, dim, own);
    const at::Tensor mixed = basis.t().mm(cross);
    part(0, shared, 0, shared).add_(basis.t().mm(of_identity.mm(basis)));
    part(0, shared, first, own).copy_(mixed);
    part(first, own, 0, shared).copy_(mixed.t());
    part(first, own, first, own).copy_(frame.matrix.narrow(0, dim, own).narrow(1, dim, own));
    right.narrow(0, 0, shared).sub_(basis.t().mv(frame.vector.narrow(0, 0, dim)));
    right.narrow(0, first, own).sub_(frame.vector.narrow(0, dim, own));
  }
  add_to_diagonal(matrix, 2 * options.prior + damping(matrix));
  right.narrow(0, 0, shared).sub_(2 * options.prior * u.to(at::kDouble));
  right.narrow(0, shared, count * own)
      .sub_(2 * options.prior * (codes - prior).to(at::kDouble).flatten());
  const at::Tensor factor = at::linalg_cholesky(matrix);
  return at::cholesky_solve(right.unsqueeze(1), factor).squeeze(1);
}

void check_codes(const ParametricHeadImpl& head, const at::Tensor& z_id) {
  FREETALK_CHECK(z_id.dim() == 1 && z_id.size(0) == head.identity_dim(), "fit: expected z_id (",
                 head.identity_dim(), ",), found ", z_id.sizes());
  FREETALK_CHECK(z_id.isfinite().all().item<bool>(), "fit: z_id holds numbers that are not finite");
}

}  // namespace

void FitOptions::check() const {
  FREETALK_CHECK(method == "gauss_newton" || method == "adam",
                 "fit method must be gauss_newton or adam, found ", method);
  FREETALK_CHECK(iterations > 0 && points >= 0 && adam_iterations > 0 && adam_points >= 0,
                 "fit: iterations must be positive, points not negative");
  FREETALK_CHECK(huber_mm > 0 && sigma_mm > 0 && tolerance_mm >= 0,
                 "fit: huber_mm and sigma_mm must be positive");
  FREETALK_CHECK(prior >= 0 && temporal >= 0, "fit: prior and temporal must not be negative");
  FREETALK_CHECK(window > overlap && overlap >= 0, "fit: window must exceed overlap");
  FREETALK_CHECK(learning_rate > 0, "fit: learning_rate must be positive");
}

Fit fit_expressions(ParametricHead head, const at::Tensor& z_id,
                    const std::vector<at::Tensor>& points, const at::Tensor& prior,
                    const FitOptions& options, at::Generator generator,
                    const FitCallback& on_step) {
  return core::with_plain_errors("fit_expressions", [&] {
    options.check();
    check_codes(*head, z_id);
    const at::NoGradGuard no_grad;
    const double scale = head->options().units_per_metre;
    const at::Tensor start =
        codes_or(prior, head->rest_expression, static_cast<int64_t>(points.size()), "prior");
    if (options.method == "adam") {
      check_frames(points);
      const at::Tensor codes =
          adam_expressions(*head, z_id, points, start, options, generator, on_step);
      std::vector<Frame> frames;
      for (size_t t = 0; t < points.size(); ++t) {
        const at::Tensor some = draw_points(points[t], options.points, scale, generator);
        const at::Tensor s = head->forward(some.unsqueeze(0), z_id.unsqueeze(0),
                                           codes[static_cast<int64_t>(t)].unsqueeze(0));
        frames.push_back({{}, {}, 0, s.abs().mean().item<double>()});
      }
      return Fit{z_id.clone(), codes, errors_mm(frames, scale)};
    }
    return gauss_newton(*head, z_id, drawn(points, options.points, scale, generator), start,
                        options, on_step);
  });
}

Fit fit_identity(ParametricHead head, const std::vector<at::Tensor>& points,
                 const at::Tensor& prior, const at::Tensor& identity_prior,
                 const FitOptions& options, at::Generator generator, const FitCallback& on_step) {
  return core::with_plain_errors("fit_identity", [&] {
    options.check();
    FREETALK_CHECK(options.method == "gauss_newton",
                   "fit_identity: only gauss_newton seeks identities, found ", options.method);
    if (identity_prior.defined()) check_codes(*head, identity_prior);
    const at::NoGradGuard no_grad;
    const double scale = head->options().units_per_metre;
    const auto count = static_cast<int64_t>(points.size());
    const auto some = drawn(points, options.points, scale, generator);
    const at::Tensor start = codes_or(prior, head->rest_expression, count, "prior");
    const IdentitySpace space(*head, identity_prior);
    const ExpressionSpace expressions(*head);
    const at::Tensor slope = expressions.basis.to(at::kFloat),
                     usual = expressions.coordinates(start);
    at::Tensor u = space.coordinates, y = usual.clone();
    const auto linearized = [&] {
      const at::Tensor z_id = space.code(u), codes = expressions.codes(y);
      std::vector<Linearized> rows;
      for (int64_t t = 0; t < count; ++t) {
        rows.push_back(linearize_both(*head, some[static_cast<size_t>(t)], z_id, codes[t]));
        const auto parts = rows.back().jacobian.split_with_sizes({z_id.size(0), slope.size(0)}, 1);
        rows.back().jacobian = at::cat({parts[0], parts[1].mm(slope)}, 1);
      }
      return rows;
    };
    const auto equations = [&](const std::vector<Linearized>& rows, double sigma_mm) {
      std::vector<Frame> frames;
      for (const Linearized& own : rows) {
        frames.push_back(normal_equations(own, options, sigma_mm, scale));
      }
      return frames;
    };
    const auto cost = [&](const std::vector<Frame>& frames) {
      double sum = options.prior * (u.square().sum() + (y - usual).square().sum()).item<double>();
      for (const Frame& frame : frames) sum += frame.cost;
      return sum;
    };
    std::vector<Linearized> rows = linearized();
    std::vector<Frame> frames;
    for (int64_t iteration = 0; iteration < options.iterations; ++iteration) {
      const double sigma_mm = spread_mm(rows, options, scale);
      frames = equations(rows, sigma_mm);
      const double before = cost(frames);
      at::Tensor step = joint_step(frames, space, u, y, usual, options);
      const at::Tensor u_before = u, y_before = y;
      std::vector<Frame> next;
      for (int halving = 0; halving <= kHalvings; ++halving, step = step / 2) {
        u = u_before + step.narrow(0, 0, u.size(0)).to(at::kFloat);
        y = y_before + step.narrow(0, u.size(0), y.numel()).view_as(y);
        rows = linearized();
        next = equations(rows, sigma_mm);
        if (cost(next) <= before) break;
      }
      const double gain = (mean_error(frames) - mean_error(next)) / scale * 1e3;
      frames = std::move(next);
      if (on_step) on_step(iteration + 1, options.iterations);
      if (std::abs(gain) < options.tolerance_mm) break;
    }
    return Fit{space.code(u), expressions.codes(y), errors_mm(frames, scale)};
  });
}

}  // namespace freetalk::head
