// FaceTalk's fitting of expressions [5, Eq. 16-18]: Adam over windows of frames.
#pragma once

#include "freetalk/head/fit.h"

namespace freetalk::head {

/// @param start (T, expression_dim). @returns (T, expression_dim).
at::Tensor adam_expressions(ParametricHeadImpl& head, const at::Tensor& z_id,
                            const std::vector<at::Tensor>& points, const at::Tensor& start,
                            const FitOptions& options, at::Generator& generator,
                            const FitCallback& on_step);

}  // namespace freetalk::head
