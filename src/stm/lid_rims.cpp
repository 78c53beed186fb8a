#include "stm/lid_rims.h"

#include <algorithm>
#include <array>
#include <deque>
#include <optional>
#include <vector>

#include "stm/gap_cut.h"

namespace freetalk::stm {
namespace {

constexpr double kPatch = 0.03;        // m around an eye that is looked at
constexpr double kNoise = 0.05;        // of the spread that tells the lids apart
constexpr double kPlaneStep = 2.5e-4;  // m between planes
constexpr double kLeastOpen = 1.5e-3;  // m: lids that are nearer to each other are shut
// Where an eye is half as open as in its middle, between its outer and its inner corner: of the
// mean face, of seven others within 0.03.
constexpr double kOuterHalf = 0.085, kInnerHalf = 0.8;
constexpr double kLeastWidth = 0.6, kMostWidth = 1.6;  // of the guessed width
constexpr double kFarthestMove = 0.01;                 // m that a landmark is moved, at most

/// Landmarks of an eye; those of the lids in the order from the outer to the inner corner.
struct Eye {
  int outer, inner;
  std::array<int, 2> upper, lower;
};
constexpr std::array<Eye, 2> kEyes{{{36, 39, {37, 38}, {41, 40}}, {45, 42, {44, 43}, {46, 47}}}};

/// The skin around an eye.
struct Patch {
  Eigen::MatrixXi faces;    // of the whole surface
  std::vector<bool> upper;  // (V,) whether a vertex is of the upper lid's side
};

/// Nothing where landmarks are elsewhere.
std::optional<Patch> patch_of(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                              const geometry::SurfacePoints& places, const Eye& eye) {
  const std::array<int, 4> lids{eye.upper[0], eye.upper[1], eye.lower[0], eye.lower[1]};
  Eigen::RowVector3d centre = Eigen::RowVector3d::Zero();
  for (const int n : lids) {
    centre += places.shares.row(n) * vertices(places.corners.row(n), Eigen::all) / 4;
  }
  std::vector<int> number(static_cast<size_t>(vertices.rows()), -1), chosen;
  std::vector<Eigen::Index> rows;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    const Eigen::RowVector3i face = faces.row(f);
    if ((vertices(face, Eigen::all).rowwise() - centre).rowwise().norm().maxCoeff() > kPatch) {
      continue;
    }
    rows.push_back(f);
    for (const int v : face) {
      if (number[static_cast<size_t>(v)] >= 0) continue;
      number[static_cast<size_t>(v)] = static_cast<int>(chosen.size());
      chosen.push_back(v);
    }
  }
  const auto numbered = [&](const Eigen::MatrixXi& of) {
    return Eigen::MatrixXi(of.unaryExpr([&](int v) { return number[static_cast<size_t>(v)]; }));
  };
  const geometry::SurfacePoints points{numbered(places.corners(lids, Eigen::all)),
                                       places.shares(lids, Eigen::all), places.distance(lids)};
  if (rows.empty() || points.corners.minCoeff() < 0) return std::nullopt;
  Patch patch{faces(rows, Eigen::all), std::vector<bool>(static_cast<size_t>(vertices.rows()))};
  const Eigen::MatrixXd weights = geometry::kriging_weights(
      vertices(chosen, Eigen::all), numbered(patch.faces), points, {.noise = kNoise});
  for (size_t v = 0; v < chosen.size(); ++v) {
    const auto of = weights.row(static_cast<Eigen::Index>(v));
    patch.upper[static_cast<size_t>(chosen[v])] = of.head(2).maxCoeff() > of.tail(2).maxCoeff();
  }
  return patch;
}

/// The rims of the lids in planes from one side of an eye to the other.
class Opening {
 public:
  /// Follows the rims from a plane in the middle to both sides. @param reach m to either side.
  Opening(const Eigen::MatrixXd& vertices, const Patch& patch, const Eigen::RowVector3d& top,
          const Eigen::RowVector3d& bottom, double reach) {
    const double middle = (top[0] + bottom[0]) / 2;
    for (const double step : {-kPlaneStep, kPlaneStep}) {
      std::array<Eigen::RowVector3d, 2> last{top, bottom};
      const double first = step < 0 ? middle : middle + step;
      for (double x = first; std::abs(x - middle) < reach; x += step) {
        last[0][0] = last[1][0] = x;
        const auto found = GapCut(vertices, patch.faces, patch.upper, last[0], last[1]).nearest();
        if (!found) break;
        last = {(*found)[0].at, (*found)[1].at};
        step < 0 ? rims_.push_front(*found) : rims_.push_back(*found);
        most_ = std::max(most_, (last[0] - last[1]).norm());
        if ((last[0] - last[1]).norm() < most_ / 4) break;
      }
    }
  }

  double most() const { return most_; }

  /// x of the planes, left and right, at which the lids are half as far apart as at most; nothing
  /// where the eye does not get so narrow.
  std::optional<std::array<double, 2>> half() const {
    const auto widest =
        std::max_element(rims_.begin(), rims_.end(),
                         [](const auto& a, const auto& b) { return apart(a) < apart(b); });
    const auto narrow = [this](const auto& rim) { return apart(rim) < most_ / 2; };
    const auto right = std::find_if(widest, rims_.end(), narrow);
    const auto left = std::find_if(std::make_reverse_iterator(widest), rims_.rend(), narrow);
    if (right == rims_.end() || left == rims_.rend()) return std::nullopt;
    return std::array{(*left)[0].at[0], (*right)[0].at[0]};
  }

  /// The rims nearest to a plane.
  const std::array<Spot, 2>& at(double x) const {
    return *std::min_element(rims_.begin(), rims_.end(), [x](const auto& a, const auto& b) {
      return std::abs(a[0].at[0] - x) < std::abs(b[0].at[0] - x);
    });
  }

 private:
  static double apart(const std::array<Spot, 2>& rim) { return (rim[0].at - rim[1].at).norm(); }

  std::deque<std::array<Spot, 2>> rims_;  // by x
  double most_ = 0;
};

}  // namespace

void put_on_their_lids(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                       const Eigen::MatrixXd& landmarks, geometry::SurfacePoints& places) {
  for (const Eye& eye : kEyes) {
    const auto patch = patch_of(vertices, faces, places, eye);
    if (!patch) continue;
    const auto middle = [&](const std::array<int, 2>& lid) {
      return Eigen::RowVector3d((landmarks.row(lid[0]) + landmarks.row(lid[1])) / 2);
    };
    const double outer = landmarks(eye.outer, 0), guessed = landmarks(eye.inner, 0) - outer;
    const Opening opening(vertices, *patch, middle(eye.upper), middle(eye.lower),
                          std::abs(guessed));
    const auto half = opening.most() > kLeastOpen ? opening.half() : std::nullopt;
    if (!half) continue;
    const auto [left, right] = *half;
    const double width = std::copysign((right - left) / (kInnerHalf - kOuterHalf), guessed);
    if (width / guessed < kLeastWidth || width / guessed > kMostWidth) continue;
    const double begin = (guessed > 0 ? left : right) - kOuterHalf * width;
    std::vector<std::pair<int, Spot>> found;
    for (size_t side = 0; side < 2; ++side) {
      for (const int n : side == 0 ? eye.upper : eye.lower) {
        const double share = (landmarks(n, 0) - outer) / guessed;
        found.emplace_back(n, opening.at(begin + share * width)[side]);
      }
    }
    const auto too_far = [&](const auto& spot) {
      return (spot.second.at - landmarks.row(spot.first)).norm() > kFarthestMove;
    };
    if (std::any_of(found.begin(), found.end(), too_far)) continue;
    Eigen::RowVector3d shift = Eigen::RowVector3d::Zero();
    for (const auto& [n, spot] : found) {
      shift += (spot.at - landmarks.row(n)) / static_cast<double>(found.size());
      places.corners.row(n) = patch->faces.row(spot.face);
      places.shares.row(n) = spot.shares;
      places.distance[n] = 0;
    }
    for (const auto& [n, share] : {std::pair{eye.outer, 0.0}, std::pair{eye.inner, 1.0}}) {
      Eigen::RowVector3d corner = landmarks.row(n) + shift;
      corner[0] = begin + share * width;
      const auto place =
          geometry::nearest_on_surface(vertices, patch->faces, corner, Eigen::RowVector3d::Zero());
      places.corners.row(n) = place.corners;
      places.shares.row(n) = place.shares;
      places.distance[n] = place.distance[0];
    }
  }
}

}  // namespace freetalk::stm
