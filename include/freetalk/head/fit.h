// Codes of a parametric head from points of a surface: scans, registered meshes, depth.
//
//   sum_t mean_p rho(s(x_tp; z_id, z_t)) + prior |y_t - prior_t|^2 + temporal |y_t+1 - y_t|^2
//
// "gauss_newton" linearises the distances of all frames and solves them together: the codes of a
// sequence meet in one block-tridiagonal system. z = L y, where L L' is how the codes of expression
// weights vary: what no expression does costs most. (y = z where a head has no weights, and where
// an identity is sought too.) The unit of distances is the points' own spread about the surface,
// found anew before each step. "adam" is FaceTalk's [Eq. 16-18]: windows of
// frames, L1 distances, a Huber loss between neighbours and a small code.
#pragma once

#include <ATen/core/Generator.h>
#include <ATen/core/Tensor.h>

#include <functional>
#include <string>
#include <vector>

#include "freetalk/head/parametric_head.h"

namespace freetalk::head {

struct FitOptions {
  std::string method = "gauss_newton";  // or "adam"
  int64_t iterations = 8;               // of Gauss-Newton
  int64_t points = 1000;                // of a frame, drawn anew for each iteration; 0: all of them
  double sigma_mm = 0.3;  // least spread of the points about the surface, the unit of distances
  double huber_mm = 1.0;  // distances beyond count linearly, where sigma_mm is the spread; in
                          // proportion to it elsewhere
  double prior = 1e-3;    // of a coordinate's square distance from its prior, in units of 1 / point
  double temporal = 0.1;  // of its square change from frame to frame, likewise; 0: frames alone
  double tolerance_mm = 1e-3;  // of the mean distance: a smaller gain ends the iterations
  // FaceTalk's method [5].
  int64_t window = 10;  // frames
  int64_t overlap = 2;  // frames of neighbouring windows, kept as found first
  int64_t adam_iterations = 500;
  int64_t adam_points = 5000;
  double learning_rate = 1e-3;  // a tenth of it after adam_decay iterations
  int64_t adam_decay = 300;
  double lambda_sdf = 10.0;  // Eq. 16
  double lambda_temp = 0.1;
  double lambda_reg = 0.0025;
  template <class V>
  void fields(V& v) {
    v("method", method);
    v("iterations", iterations);
    v("points", points);
    v("huber_mm", huber_mm);
    v("sigma_mm", sigma_mm);
    v("prior", prior);
    v("temporal", temporal);
    v("tolerance_mm", tolerance_mm);
    v("window", window);
    v("overlap", overlap);
    v("adam_iterations", adam_iterations);
    v("adam_points", adam_points);
    v("learning_rate", learning_rate);
    v("adam_decay", adam_decay);
    v("lambda_sdf", lambda_sdf);
    v("lambda_temp", lambda_temp);
    v("lambda_reg", lambda_reg);
  }
  void check() const;
};

struct Fit {
  at::Tensor z_id;      // (identity_dim,)
  at::Tensor z_exp;     // (T, expression_dim)
  at::Tensor error_mm;  // (T,) mean |s| of each frame's points, head's own distance
};

/// Called with iterations done and iterations in all; it may throw to stop.
using FitCallback = std::function<void(int64_t, int64_t)>;

/// Expression codes of frames under a known identity.
/// @param points T of (P_t, 3) posed, metres, float; P_t > 0.
/// @param prior (T, expression_dim) codes to stay near and to begin from; undefined: the head's
/// rest_expression. @throws std::invalid_argument for empty frames and numbers that are not finite.
Fit fit_expressions(ParametricHead head, const at::Tensor& z_id,
                    const std::vector<at::Tensor>& points, const at::Tensor& prior,
                    const FitOptions& options, at::Generator generator,
                    const FitCallback& on_step = {});

/// The identity that frames share, and their expressions.
/// @param prior as above. @param identity_prior (identity_dim,) begun from; undefined: the head's
/// identity_mean. Where the head has identity_map, its coefficients are sought, about 0.
Fit fit_identity(ParametricHead head, const std::vector<at::Tensor>& points,
                 const at::Tensor& prior, const at::Tensor& identity_prior,
                 const FitOptions& options, at::Generator generator,
                 const FitCallback& on_step = {});

}  // namespace freetalk::head
