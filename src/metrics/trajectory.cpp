#include "freetalk/metrics/trajectory.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <vector>

#include "freetalk/core/error.h"
#include "select.h"

namespace freetalk::metrics {
namespace {

enum class Coupling { kSum, kGreatest };

/// One row of the table of least path costs, C trajectories side by side; rows are added in turn.
class PathTable {
 public:
  PathTable(Coupling coupling, int64_t columns, int64_t channels)
      : coupling_(coupling),
        columns_(columns),
        channels_(channels),
        costs_(static_cast<size_t>(columns * channels)),
        above_left_(static_cast<size_t>(channels)),
        above_(static_cast<size_t>(channels)) {}

  /// @param distances (columns, channels) row-major: of the next frame to every frame of the other.
  void add_row(const double* distances) {
    for (int64_t s = 0; s < columns_; ++s) {
      double* cost = costs_.data() + s * channels_;
      const double* left = s > 0 ? cost - channels_ : nullptr;
      const double* distance = distances + s * channels_;
      for (int64_t c = 0; c < channels_; ++c) {
        above_[c] = cost[c];
        cost[c] = joined(reached(left, c, s), distance[c]);
      }
      std::swap(above_, above_left_);
    }
    is_first_row_ = false;
  }

  /// Mean over the trajectories of the least cost of a whole path.
  double mean_cost() const {
    double sum = 0;
    for (int64_t c = 0; c < channels_; ++c) sum += costs_[(columns_ - 1) * channels_ + c];
    return sum / static_cast<double>(channels_);
  }

 private:
  /// Least cost of getting next to column s of the new row; negative at the start of the path.
  double reached(const double* left, int64_t c, int64_t s) const {
    if (is_first_row_) return left ? left[c] : -1;
    if (s == 0) return above_[c];
    return std::min({above_[c], above_left_[c], left[c]});
  }

  double joined(double before, double distance) const {
    if (coupling_ == Coupling::kGreatest) return std::max(before, distance);
    return before < 0 ? distance : before + distance;
  }

  Coupling coupling_;
  int64_t columns_, channels_;
  std::vector<double> costs_, above_left_, above_;
  bool is_first_row_ = true;
};

struct Couple {
  double cost = 0;
  int64_t target_frames = 0;
};

/// @param pred (T, M, 3), target (T', M, 3) float64.
Couple couple(const at::Tensor& pred, const at::Tensor& target, Coupling coupling,
              bool each_vertex) {
  const at::Tensor rows = pred.permute({2, 0, 1}).contiguous();       // (3, T, M)
  const at::Tensor columns = target.permute({2, 0, 1}).contiguous();  // (3, T', M)
  const int64_t num_columns = target.size(0), num_vertices = target.size(1);
  PathTable table(coupling, num_columns, each_vertex ? num_vertices : 1);
  for (int64_t t = 0; t < pred.size(0); ++t) {
    at::Tensor squared = (columns[0] - rows[0][t]).square_();
    for (int64_t axis = 1; axis < 3; ++axis) {
      const at::Tensor difference = columns[axis] - rows[axis][t];
      squared.addcmul_(difference, difference);
    }
    at::Tensor distances = squared.sqrt_();  // (T', M)
    if (!each_vertex) distances = distances.mean(1);
    distances = distances.cpu().contiguous();
    table.add_row(distances.data_ptr<double>());
  }
  return {table.mean_cost(), num_columns};
}

std::vector<Couple> couples(const at::Tensor& pred, const at::Tensor& target,
                            const Selection& selection, Coupling coupling, bool each_vertex,
                            const char* metric) {
  check_motion(pred, metric, "pred");
  check_motion(target, metric, "target");
  FREETALK_CHECK(pred.size(0) == target.size(0) && pred.size(2) == target.size(2), metric,
                 ": pred ", pred.sizes(), " and target ", target.sizes(),
                 " differ in more than their frames");
  FREETALK_CHECK(pred.device() == target.device(), metric, ": pred is on ", pred.device(),
                 ", target on ", target.device());
  const bool shared = !selection.target_valid.defined() && pred.size(1) == target.size(1);
  const at::Tensor valid = valid_frames(selection.valid, pred, 1, metric);
  const at::Tensor target_valid =
      valid_frames(shared ? selection.valid : selection.target_valid, target, 1, metric);
  const at::Tensor indices = vertex_indices(selection, pred, metric);
  std::vector<Couple> result;
  for (int64_t b = 0; b < pred.size(0); ++b) {
    const at::Tensor rows = pred[b].index_select(0, valid[b].nonzero().squeeze(1)).unsqueeze(0);
    const at::Tensor columns =
        target[b].index_select(0, target_valid[b].nonzero().squeeze(1)).unsqueeze(0);
    result.push_back(couple(take_vertices(rows, indices)[0], take_vertices(columns, indices)[0],
                            coupling, each_vertex));
  }
  return result;
}

at::Tensor costs(const std::vector<Couple>& couples, bool per_frame, c10::Device device) {
  at::Tensor result = at::empty({static_cast<int64_t>(couples.size())}, at::kDouble);
  for (size_t b = 0; b < couples.size(); ++b) {
    result[static_cast<int64_t>(b)] =
        couples[b].cost / (per_frame ? static_cast<double>(couples[b].target_frames) : 1.0);
  }
  return result.to(device);
}

}  // namespace

at::Tensor dtw(const at::Tensor& pred, const at::Tensor& target, const Selection& selection) {
  return costs(couples(pred, target, selection, Coupling::kSum, false, "dtw"), true, pred.device());
}

at::Tensor dtw_sum(const at::Tensor& pred, const at::Tensor& target, const Selection& selection) {
  return costs(couples(pred, target, selection, Coupling::kSum, false, "dtw_sum"), false,
               pred.device());
}

at::Tensor dtw_vertex(const at::Tensor& pred, const at::Tensor& target,
                      const Selection& selection) {
  return costs(couples(pred, target, selection, Coupling::kSum, true, "dtw_vertex"), true,
               pred.device());
}

at::Tensor dfd(const at::Tensor& pred, const at::Tensor& target, const Selection& selection) {
  return costs(couples(pred, target, selection, Coupling::kGreatest, false, "dfd"), false,
               pred.device());
}

at::Tensor dfd_vertex(const at::Tensor& pred, const at::Tensor& target,
                      const Selection& selection) {
  return costs(couples(pred, target, selection, Coupling::kGreatest, true, "dfd_vertex"), false,
               pred.device());
}

}  // namespace freetalk::metrics
