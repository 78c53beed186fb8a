#include "mesh_rows.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <array>
#include <utility>

#include "mesh/kd_order.h"

namespace freetalk::nn {
namespace {

/// The first eigenvectors that vary are coordinates of the surface: a k-d order along them keeps
/// what lies together on the surface together.
std::vector<int> local_order(const at::Tensor& evecs) {
  const int64_t count = std::min<int64_t>(3, evecs.size(1) - 1);
  Eigen::Matrix3Xd coordinates = Eigen::Matrix3Xd::Zero(3, evecs.size(0));
  const at::Tensor chosen = evecs.narrow(1, 1, count).to(at::kDouble).t().contiguous();
  for (int64_t axis = 0; axis < count; ++axis) {
    coordinates.row(axis) = Eigen::Map<const Eigen::RowVectorXd>(
        chosen[axis].const_data_ptr<double>(), coordinates.cols());
  }
  return mesh::KdOrder(coordinates).points;
}

using Entry = std::pair<int32_t, std::array<float, 2>>;

}  // namespace

MeshRows::MeshRows(const geometry::SurfaceOperators& operators) {
  const int64_t vertices = operators.num_vertices();
  const std::vector<int> from = local_order(operators.evecs);
  std::vector<int32_t> to(from.size());
  for (size_t i = 0; i < from.size(); ++i) to[from[i]] = static_cast<int32_t>(i);
  order = at::empty({vertices}, at::kLong);
  std::copy(from.begin(), from.end(), order.data_ptr<int64_t>());

  const at::Tensor rows = operators.gradients.rows.to(at::kLong).contiguous();
  const at::Tensor columns = operators.gradients.columns.to(at::kLong).contiguous();
  const at::Tensor values = operators.gradients.values.to(at::kFloat).contiguous();
  const auto* row = rows.const_data_ptr<int64_t>();
  const auto* column = columns.const_data_ptr<int64_t>();
  const auto* value = values.const_data_ptr<float>();
  std::vector<Entry> entries;
  first.push_back(0);
  for (const int v : from) {
    entries.clear();
    for (const int component : {0, 1}) {
      const int64_t at = component * vertices + v;
      for (int64_t e = row[at]; e < row[at + 1]; ++e) {
        entries.push_back({to[column[e]], {}});
        entries.back().second[component] = value[e];
      }
    }
    std::sort(entries.begin(), entries.end(),
              [](const Entry& a, const Entry& b) { return a.first < b.first; });
    for (size_t e = 0; e < entries.size(); ++e) {
      if (e == 0 || entries[e].first != entries[e - 1].first) {
        neighbor.push_back(entries[e].first);
        weight.insert(weight.end(), {0.0F, 0.0F});
      }
      weight[weight.size() - 2] += entries[e].second[0];
      weight[weight.size() - 1] += entries[e].second[1];
    }
    first.push_back(static_cast<int32_t>(neighbor.size()));
  }
}

}  // namespace freetalk::nn
