#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <utility>
#include <vector>

#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "freetalk/mesh/lip_slit.h"
#include "mesh/union_find.h"

namespace freetalk::mesh {
namespace {

constexpr int kNose = 33, kChin = 8;
constexpr double kDeepest = 0.010;  // m behind the line from nose to chin

/// Whether nose and chin are connected in the plane of that x, over the front.
bool joined_at(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
               const Eigen::RowVector3d& nose, const Eigen::RowVector3d& chin, double x) {
  const auto shallow = [&](const Eigen::RowVector3d& at) {
    const double share = (at[1] - nose[1]) / (chin[1] - nose[1]);
    return at[2] > nose[2] + std::clamp(share, 0.0, 1.0) * (chin[2] - nose[2]) - kDeepest;
  };
  std::map<std::pair<int, int>, int> number;  // of the edges that the plane crosses
  std::vector<Eigen::RowVector3d> places;
  std::vector<std::pair<int, int>> links;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    int found = 0, ends[2] = {0, 0};
    for (int k = 0; k < 3; ++k) {
      const auto [a, b] = std::minmax(faces(f, k), faces(f, (k + 1) % 3));
      if ((vertices(a, 0) < x) == (vertices(b, 0) < x)) continue;
      const auto [entry, made] = number.try_emplace({a, b}, static_cast<int>(places.size()));
      if (made) {
        const double share = (x - vertices(a, 0)) / (vertices(b, 0) - vertices(a, 0));
        places.push_back(vertices.row(a) + share * (vertices.row(b) - vertices.row(a)));
      }
      ends[found++] = entry->second;
    }
    if (found == 2 && shallow(places[static_cast<size_t>(ends[0])]) &&
        shallow(places[static_cast<size_t>(ends[1])])) {
      links.emplace_back(ends[0], ends[1]);
    }
  }
  if (links.empty()) return false;
  UnionFind parts(places.size());
  for (const auto& [a, b] : links) parts.join(a, b);
  const auto nearest = [&](const Eigen::RowVector3d& to) {
    int best = links.front().first;
    for (const auto& [a, b] : links) {
      for (const int each : {a, b}) {
        const auto far = [&](int i) { return (places[static_cast<size_t>(i)] - to).norm(); };
        if (far(each) < far(best)) best = each;
      }
    }
    return best;
  };
  return parts.root(nearest(nose)) == parts.root(nearest(chin));
}

}  // namespace

bool lips_are_joined(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                     const Eigen::MatrixXd& landmarks) {
  FREETALK_CHECK(landmarks.rows() == core::kNumLandmarks && landmarks.cols() == 3,
                 "expected landmarks (68, 3), found (", landmarks.rows(), ", ", landmarks.cols(),
                 ")");
  int joined = 0;
  for (const auto& [upper, lower] : core::kInnerLips) {
    const double x = (landmarks(upper, 0) + landmarks(lower, 0)) / 2;
    joined += joined_at(vertices, faces, landmarks.row(kNose), landmarks.row(kChin), x);
  }
  return 2 * joined > static_cast<int>(core::kInnerLips.size());
}

}  // namespace freetalk::mesh
