#include "freetalk/mesh/lip_slit.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <queue>
#include <set>
#include <utility>

#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "mesh/mouth_pocket.h"
#include "mesh/surface_patch.h"

namespace freetalk::mesh {
namespace {

constexpr double kRegion = 0.05;   // m around the middle of the lips that is taken apart
constexpr double kValley = 0.003;  // m around a vertex, in which its depth is told
constexpr double kSteep = 0.15;    // of kValley: a depth from which a valley is a crease
constexpr double kFlatCost = 1.0;  // of a path, beside its length, where no crease is
constexpr double kAstray = 0.002;  // m from the landmarks' line at which a path costs twice
constexpr double kBase = 0.2;      // of a path's length, in a crease at the landmarks
constexpr int kSmoothings = 6;
constexpr double kBand = 0.0015;    // m around the smoothed path in which edges are split
constexpr double kSnap = 0.3;       // of an edge: nearer to the curve, its end serves
constexpr double kOffCurve = 20.0;  // cost of a path beside the curve
constexpr size_t kFewest = 5;       // vertices of a slit
constexpr size_t kMost = 100000;    // vertices that halving edges may add

/// From corner to corner of the inner lips.
std::vector<om::Vec3d> line_between_lips(const Eigen::MatrixXd& landmarks) {
  std::vector<om::Vec3d> line{vec(landmarks.row(60))};
  for (const auto& [upper, lower] : core::kInnerLips) {
    line.push_back(vec((landmarks.row(upper) + landmarks.row(lower)) / 2));
  }
  line.push_back(vec(landmarks.row(64)));
  return line;
}

/// Distance between the segments a-b and c-d [Ericson, Real-Time Collision Detection, 5.1.9].
double apart(const om::Vec3d& a, const om::Vec3d& b, const om::Vec3d& c, const om::Vec3d& d) {
  const om::Vec3d u = b - a, v = d - c, w = a - c;
  const double uu = std::max(u.sqrnorm(), 1e-18), vv = std::max(v.sqrnorm(), 1e-18), uv = u | v;
  const double cross = uu * vv - uv * uv;
  double s = cross > 1e-12 * uu * vv ? ((uv * (v | w)) - vv * (u | w)) / cross : 0;
  s = std::clamp(s, 0.0, 1.0);
  const double t = std::clamp((uv * s + (v | w)) / vv, 0.0, 1.0);
  s = std::clamp((uv * t - (u | w)) / uu, 0.0, 1.0);
  return (w + u * s - v * t).norm();
}

/// Polygons, taken whole or not at all, around a place.
std::vector<bool> polygons_around(const Mesh& mesh, const om::Vec3d& middle) {
  std::vector<bool> near(static_cast<size_t>(mesh.num_polygons()), true);
  for (Eigen::Index f = 0; f < mesh.num_faces(); ++f) {
    for (int k = 0; k < 3; ++k) {
      if ((vec(mesh.vertices.row(mesh.faces(f, k))) - middle).norm() >= kRegion) {
        near[static_cast<size_t>(mesh.face_polygon[static_cast<size_t>(f)])] = false;
      }
    }
  }
  return near;
}

/// The surface around the lips, edges near them halved until they are short; the path of the slit,
/// and the cut along it.
class Surgery : public SurfacePatch {
 public:
  Surgery(const Mesh& mesh, const Eigen::MatrixXd& landmarks, const SlitOptions& options)
      : SurfacePatch(mesh, polygons_around(mesh, line_between_lips(landmarks)[2])),
        options_(options),
        line_(line_between_lips(landmarks)) {
    FREETALK_RUNTIME_CHECK(manifold(), mesh.name,
                           ": the surface around the lips is not manifold, so no slit is cut; "
                           "drop duplicate and floating polygons first");
    refine();
    find_path();
    straighten();
    find_path();
  }

  LipSlit result() {
    LipSlit slit;
    cut();
    put_together(slit);
    for (const int v : below_) slit.mesh.vertices(v, 1) -= options_.gap;
    slit.edges = static_cast<int64_t>(path_.size()) - 1;
    const auto polygons = slit.mesh.polygons.size(), vertices = slit.added.size();
    if (options_.depth > 0) {
      sew_pocket(upper_, lower_, options_.depth, rim_polygon_, slit);
    }
    slit.pocket_polygons = static_cast<int64_t>(slit.mesh.polygons.size() - polygons);
    slit.pocket_vertices = static_cast<int64_t>(slit.added.size() - vertices);
    return slit;
  }

 private:
  /// From the line between the corners of the inner lips, m.
  double distance(const om::Vec3d& point) const {
    double least = std::numeric_limits<double>::infinity();
    for (size_t i = 0; i + 1 < line_.size(); ++i) {
      const om::Vec3d along = line_[i + 1] - line_[i];
      const double share = ((point - line_[i]) | along) / std::max(along.sqrnorm(), 1e-18);
      least = std::min(least, (point - line_[i] - along * std::clamp(share, 0.0, 1.0)).norm());
    }
    return least;
  }

  bool to_halve(om::EdgeHandle edge) const {
    if (surface_.is_boundary(edge) || surface_.calc_edge_length(edge) <= options_.edge) {
      return false;
    }
    const om::HalfedgeHandle half = surface_.halfedge_handle(edge, 0);
    const om::Vec3d a = surface_.point(surface_.from_vertex_handle(half));
    const om::Vec3d b = surface_.point(surface_.to_vertex_handle(half));
    for (size_t i = 0; i + 1 < line_.size(); ++i) {
      if (apart(a, b, line_[i], line_[i + 1]) < options_.corridor) return true;
    }
    return false;
  }

  void refine() {
    const auto longest = [this](om::EdgeHandle edge) {
      return to_halve(edge) ? surface_.calc_edge_length(edge) : 0.0;
    };
    halve_longest(longest, [this](om::EdgeHandle) {
      FREETALK_RUNTIME_CHECK(added_.size() < kMost, mesh_.name,
                             ": the edges around the lips cannot be made as short as ",
                             1000 * options_.edge, " mm, so no slit is cut");
      return true;
    });
  }

  /// How much of a crease a vertex lies in, in [0, 1].
  double crease(Vertex v) {
    const om::Vec3d own = surface_.point(v);
    std::set<Vertex> seen{v};
    std::vector<Vertex> queue{v};
    om::Vec3d sum(0, 0, 0), normal(0, 0, 0);
    for (size_t i = 0; i < queue.size(); ++i) {
      for (const om::FaceHandle face : surface_.vf_range(queue[i])) {
        normal += surface_.calc_face_normal(face) * surface_.calc_face_area(face);
      }
      for (const Vertex each : surface_.vv_range(queue[i])) {
        if ((surface_.point(each) - own).norm() < kValley && seen.insert(each).second) {
          queue.push_back(each);
          sum += surface_.point(each) - own;
        }
      }
    }
    if (queue.size() < 2) return 0;
    const double depth =
        (sum / static_cast<double>(queue.size() - 1)) | (normal / std::max(normal.norm(), 1e-18));
    return std::clamp(depth / (kSteep * kValley), 0.0, 1.0);
  }

  /// Splits edges where a smooth curve along the path crosses them, and notes what lies on it.
  void straighten() {
    std::vector<om::Vec3d> curve;
    for (const Vertex v : path_) curve.push_back(surface_.point(v));
    for (int pass = 0; pass < kSmoothings; ++pass) {
      const std::vector<om::Vec3d> before = curve;
      for (size_t i = 1; i + 1 < curve.size(); ++i) {
        curve[i] = (before[i - 1] + before[i] * 2 + before[i + 1]) * 0.25;
      }
    }
    std::sort(curve.begin(), curve.end(), [](const auto& a, const auto& b) { return a[0] < b[0]; });
    const auto above = [&](const om::Vec3d& point) -> std::optional<double> {
      const auto right = std::lower_bound(curve.begin(), curve.end(), point[0],
                                          [](const auto& a, double x) { return a[0] < x; });
      if (right == curve.begin() || right == curve.end()) return std::nullopt;
      const om::Vec3d &a = *std::prev(right), &b = *right;
      const double share = (point[0] - a[0]) / std::max(b[0] - a[0], 1e-18);
      const om::Vec3d away = point - (a * (1 - share) + b * share);
      return away.norm() < kBand ? std::optional(away[1]) : std::nullopt;
    };
    on_curve_ = {path_.front(), path_.back()};
    std::vector<std::pair<om::EdgeHandle, double>> crossed;
    for (const om::EdgeHandle edge : surface_.edges()) {
      if (surface_.is_boundary(edge)) continue;
      const om::HalfedgeHandle half = surface_.halfedge_handle(edge, 0);
      const Vertex a = surface_.from_vertex_handle(half), b = surface_.to_vertex_handle(half);
      const auto at_a = above(surface_.point(a)), at_b = above(surface_.point(b));
      if (!at_a || !at_b || (*at_a < 0) == (*at_b < 0)) continue;
      const double share = *at_a / (*at_a - *at_b);
      if (share < kSnap) on_curve_.insert(a);
      if (share > 1 - kSnap) on_curve_.insert(b);
      if (share >= kSnap && share <= 1 - kSnap) crossed.emplace_back(edge, share);
    }
    for (const auto& [edge, share] : crossed) on_curve_.insert(split(edge, share));
    path_.clear();
  }

  Vertex nearest(const om::Vec3d& point) const {
    Vertex best = surface_.vertex_handle(0);
    for (const Vertex v : surface_.vertices()) {
      if ((surface_.point(v) - point).norm() < (surface_.point(best) - point).norm()) best = v;
    }
    return best;
  }

  /// The cheapest path from corner to corner, along the crease and near the landmarks.
  void find_path() {
    FREETALK_RUNTIME_CHECK(surface_.n_vertices() > 0, mesh_.name, ": no surface is at the lips");
    if (on_curve_.empty()) ends_ = {nearest(line_.front()), nearest(line_.back())};
    const auto [start, end] = ends_;
    std::map<Vertex, double> cost, flat;
    std::map<Vertex, Vertex> before;
    const auto price = [&](Vertex v) {
      const auto [entry, made] = flat.try_emplace(v);
      if (made) {
        const double astray = distance(surface_.point(v)) / kAstray;
        entry->second = kBase;
        if (on_curve_.empty()) {
          entry->second += kFlatCost * (1 - crease(v)) + astray * astray;
        } else if (!on_curve_.contains(v)) {
          entry->second = kOffCurve;
        }
      }
      return entry->second;
    };
    using Step = std::pair<double, Vertex>;
    std::priority_queue<Step, std::vector<Step>, std::greater<>> queue;
    queue.emplace(cost[start] = 0, start);
    while (!queue.empty()) {
      const auto [spent, at] = queue.top();
      queue.pop();
      if (at == end) break;
      if (spent > cost[at]) continue;
      for (const Vertex next : surface_.vv_range(at)) {
        if (surface_.is_boundary(next)) continue;
        const double length = (surface_.point(next) - surface_.point(at)).norm();
        const double total = spent + length * (price(at) + price(next)) / 2;
        const auto [entry, made] = cost.try_emplace(next, total);
        if (!made && entry->second <= total) continue;
        entry->second = total;
        before[next] = at;
        queue.emplace(total, next);
      }
    }
    for (Vertex v = end; v.is_valid(); v = v == start ? Vertex() : before[v]) path_.push_back(v);
    std::reverse(path_.begin(), path_.end());
    FREETALK_RUNTIME_CHECK(path_.front() == start && path_.size() >= kFewest, mesh_.name,
                           ": no path leads from one corner of the mouth to the other over the "
                           "surface; look at 'freetalk mesh landmarks --picture'");
  }

  /// Gives the triangles below the path vertices of their own.
  void cut() {
    std::map<int, int> copies;
    const auto rim = [&](Vertex v, om::HalfedgeHandle side, std::vector<RimVertex>& to) {
      const auto face = static_cast<size_t>(surface_.face_handle(side).idx());
      const Corner& corner = corner_at(corners_[face], v);
      to.push_back({corner.vertex, corner.texcoord});
      return polygon_[face];
    };
    for (size_t i = 0; i + 1 < path_.size(); ++i) {
      const om::HalfedgeHandle along = surface_.find_halfedge(path_[i], path_[i + 1]);
      rim_polygon_ = rim(path_[i], along, upper_);
      if (i + 2 == path_.size()) rim(path_[i + 1], along, upper_);
      if (i == 0) continue;
      // Clockwise from the path's next vertex to the one before lies what is below.
      for (auto half = along; surface_.to_vertex_handle(half) != path_[i - 1];) {
        const om::HalfedgeHandle back = surface_.opposite_halfedge_handle(half);
        const auto face = static_cast<size_t>(surface_.face_handle(back).idx());
        Corner& corner = corner_at(corners_[face], path_[i]);
        const auto [copy, made] = copies.try_emplace(corner.vertex);
        if (made) copy->second = new_vertex({corner.vertex, corner.vertex, 0.0});
        corner.vertex = copy->second;
        below_.insert(copy->second);
        half = surface_.next_halfedge_handle(back);
        changed_[static_cast<size_t>(polygon_[face])] = true;
      }
    }
    for (size_t i = 0; i < path_.size(); ++i) {
      const size_t from = std::min(i, path_.size() - 2);
      const auto side = surface_.find_halfedge(path_[from + 1], path_[from]);
      rim(path_[i], side, lower_);
    }
    lower_.front() = upper_.front();
    lower_.back() = upper_.back();
  }

  const SlitOptions& options_;
  std::vector<om::Vec3d> line_;  // from corner to corner of the inner lips
  std::set<int> below_;
  std::vector<Vertex> path_;
  std::pair<Vertex, Vertex> ends_;
  std::set<Vertex> on_curve_;
  std::vector<RimVertex> upper_, lower_;
  int rim_polygon_ = 0;
};

}  // namespace

void SlitOptions::check() const {
  FREETALK_CHECK(edge > 0 && corridor > 0 && gap >= 0 && depth >= 0,
                 "slit: edge and corridor must be positive, gap and depth not negative; found ",
                 edge, ", ", corridor, ", ", gap, " and ", depth);
}

LipSlit cut_lips(const Mesh& mesh, const Eigen::MatrixXd& landmarks, const SlitOptions& options) {
  options.check();
  FREETALK_CHECK(landmarks.rows() == core::kNumLandmarks && landmarks.cols() == 3,
                 "expected landmarks (68, 3), found (", landmarks.rows(), ", ", landmarks.cols(),
                 ")");
  LipSlit slit = Surgery(mesh, landmarks, options).result();
  Mesh whole = make_mesh(slit.mesh.vertices, slit.mesh.polygons, slit.mesh.texcoords,
                         slit.mesh.polygon_texcoords, mesh.name);
  slit.mesh = std::move(whole);
  return slit;
}

}  // namespace freetalk::mesh
