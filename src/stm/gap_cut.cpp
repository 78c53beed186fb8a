#include "stm/gap_cut.h"

#include <cmath>
#include <limits>

namespace freetalk::stm {
namespace {

constexpr double kAround = 0.005;  // m around a point, in which its side is looked for
constexpr double kFilled = 0.002;  // m: joined sides farther apart have skin between them
constexpr double kSample = 1e-4;   // m between samples of a side

}  // namespace

Eigen::RowVector3d Spot::displacement(const Eigen::MatrixXi& faces,
                                      const at::TensorAccessor<float, 3>& moved) const {
  Eigen::RowVector3d sum = Eigen::RowVector3d::Zero();
  for (int k = 0; k < 3; ++k) {
    for (int axis = 0; axis < 3; ++axis) sum[axis] += shares[k] * moved[0][faces(face, k)][axis];
  }
  return sum;
}

GapCut::GapCut(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
               const std::vector<bool>& upper, const Eigen::RowVector3d& top,
               const Eigen::RowVector3d& bottom)
    : centre_{top, bottom}, x_((top[0] + bottom[0]) / 2) {
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    const auto corner = [&](int k) { return vertices.row(faces(f, k)); };
    int uppers = 0, left = 0;
    for (int k = 0; k < 3; ++k) {
      uppers += upper[static_cast<size_t>(faces(f, k))];
      left += corner(k)[0] < x_;
    }
    if (left == 0 || left == 3) continue;
    std::array<Spot, 2> ends;
    size_t found = 0;
    for (int k = 0; k < 3; ++k) {
      const Eigen::RowVector3d a = corner(k), b = corner((k + 1) % 3);
      if ((a[0] < x_) == (b[0] < x_)) continue;
      const double share = (x_ - a[0]) / (b[0] - a[0]);
      Spot& end = ends[found++];
      end = {static_cast<int>(f), a + share * (b - a), Eigen::RowVector3d::Zero()};
      end.shares[k] = 1 - share;
      end.shares[(k + 1) % 3] = share;
    }
    sample(ends[0], ends[1], uppers);
  }
}

std::optional<double> GapCut::clearance() const {
  if (joined_) {
    const double apart = (centre_[0] - centre_[1]).norm();
    return apart > kFilled ? apart : 0.0;
  }
  const auto found = nearest();
  if (!found) return std::nullopt;
  return ((*found)[0].at - (*found)[1].at).norm();
}

std::optional<std::array<Spot, 2>> GapCut::nearest() const {
  if (sides_[0].empty() || sides_[1].empty()) return std::nullopt;
  double least = std::numeric_limits<double>::infinity();
  std::array<Spot, 2> result{sides_[0].front(), sides_[1].front()};
  for (const auto& a : sides_[0]) {
    for (const auto& b : sides_[1]) {
      const double distance = (a.at - b.at).squaredNorm();
      if (distance >= least) continue;
      least = distance;
      result = {a, b};
    }
  }
  return result;
}

void GapCut::sample(const Spot& from, const Spot& to, int uppers) {
  const auto steps = static_cast<int>((to.at - from.at).norm() / kSample) + 1;
  for (int i = 0; i <= steps; ++i) {
    const double way = static_cast<double>(i) / steps;
    const Spot spot{from.face, from.at + (to.at - from.at) * way,
                    from.shares + (to.shares - from.shares) * way};
    const auto near = [&](size_t side) { return (spot.at - centre_[side]).norm() < kAround; };
    if (uppers == 3 && near(0)) sides_[0].push_back(spot);
    if (uppers == 0 && near(1)) sides_[1].push_back(spot);
    if (uppers % 3 != 0 && (near(0) || near(1))) joined_ = true;
  }
}

}  // namespace freetalk::stm
