#include "select.h"

#include <ATen/ATen.h>

#include "freetalk/core/error.h"

namespace freetalk::metrics {
namespace {

at::Tensor along_frames(const at::Tensor& valid, int64_t num_dims) {
  std::vector<int64_t> shape(static_cast<size_t>(num_dims), 1);
  shape[0] = valid.size(0), shape[1] = valid.size(1);
  return valid.view(shape);
}

}  // namespace

void check_motion(const at::Tensor& motion, const std::string& metric, const char* name) {
  FREETALK_CHECK(
      motion.defined() && motion.dim() == 4 && motion.size(-1) == 3 && motion.numel() > 0 &&
          motion.is_floating_point(),
      metric, ": expected ", name, " (B, T, V, 3) floating point and not empty, found ",
      motion.defined() ? c10::str(motion.sizes(), " ", motion.scalar_type()) : "nothing");
}

at::Tensor vertex_indices(const Selection& selection, const at::Tensor& motion,
                          const std::string& metric) {
  const at::Tensor& mask = selection.vertices;
  if (!mask.defined()) return mask;
  const int64_t count = motion.size(2);
  FREETALK_CHECK(mask.dim() == 1 && mask.numel() > 0, metric,
                 ": expected a mask (V,) bool or (M,) int64 with an entry at least, found ",
                 mask.sizes());
  if (mask.scalar_type() == at::kBool) {
    FREETALK_CHECK(mask.size(0) == count, metric, ": the mask is for ", mask.size(0),
                   " vertices, the motion has ", count);
    const at::Tensor indices = mask.nonzero().squeeze(1);
    FREETALK_CHECK(indices.numel() > 0, metric, ": the mask holds no vertex");
    return indices.to(motion.device());
  }
  FREETALK_CHECK(mask.scalar_type() == at::kLong, metric,
                 ": expected a mask of bool or int64, found ", mask.scalar_type());
  const int64_t lowest = mask.min().item<int64_t>(), highest = mask.max().item<int64_t>();
  FREETALK_CHECK(lowest >= 0 && highest < count, metric, ": the mask names vertex ",
                 lowest < 0 ? lowest : highest, ", the motion has ", count);
  return mask.to(motion.device());
}

at::Tensor valid_frames(const at::Tensor& valid, const at::Tensor& motion, int64_t run,
                        const std::string& metric) {
  const int64_t batch = motion.size(0), frames = motion.size(1);
  at::Tensor result = valid;
  if (!valid.defined()) {
    result = at::ones({batch, frames}, motion.options().dtype(at::kBool));
  }
  FREETALK_CHECK(result.scalar_type() == at::kBool && result.dim() == 2 &&
                     result.size(0) == batch && result.size(1) == frames,
                 metric, ": expected valid (", batch, ", ", frames, ") bool, found ",
                 result.sizes(), " ", result.scalar_type());
  result = result.to(motion.device());
  FREETALK_CHECK(frames >= run, metric, ": needs ", run, " frames, found ", frames);
  const at::Tensor lacking = valid_runs(result, run).any(1).logical_not();
  FREETALK_CHECK(!lacking.any().item<bool>(), metric, ": sequence ",
                 lacking.any().item<bool>() ? lacking.nonzero()[0].item<int64_t>() : 0,
                 " of the batch has no ", run,
                 run == 1 ? " valid frame" : " valid frames in a row");
  return result;
}

at::Tensor take_vertices(const at::Tensor& motion, const at::Tensor& indices) {
  return (indices.defined() ? motion.index_select(2, indices) : motion).to(at::kDouble);
}

Motions select_motions(const at::Tensor& pred, const at::Tensor& target, const Selection& selection,
                       int64_t run, const std::string& metric) {
  check_motion(pred, metric, "pred");
  check_motion(target, metric, "target");
  FREETALK_CHECK(pred.sizes() == target.sizes(), metric, ": pred ", pred.sizes(), " and target ",
                 target.sizes(), " differ in shape");
  FREETALK_CHECK(pred.device() == target.device(), metric, ": pred is on ", pred.device(),
                 ", target on ", target.device());
  const at::Tensor indices = vertex_indices(selection, pred, metric);
  return {take_vertices(pred, indices), take_vertices(target, indices),
          valid_frames(selection.valid, pred, run, metric)};
}

at::Tensor valid_runs(const at::Tensor& valid, int64_t run) {
  const int64_t starts = valid.size(1) - run + 1;
  at::Tensor result = valid.narrow(1, 0, starts);
  for (int64_t k = 1; k < run; ++k) result = result.logical_and(valid.narrow(1, k, starts));
  return result;
}

at::Tensor mean_over_frames(const at::Tensor& values, const at::Tensor& valid) {
  const at::Tensor counted = along_frames(valid, values.dim());
  const at::Tensor sum = at::where(counted, values, at::zeros({}, values.options())).sum(1);
  std::vector<int64_t> shape(static_cast<size_t>(values.dim() - 1), 1);
  shape[0] = valid.size(0);
  return sum / valid.sum(1).to(values.scalar_type()).view(shape);
}

at::Tensor squared_length(const at::Tensor& vectors) {
  at::Tensor result = vectors.select(-1, 0).square();
  for (int64_t axis = 1; axis < 3; ++axis) result.add_(vectors.select(-1, axis).square());
  return result;
}

}  // namespace freetalk::metrics
