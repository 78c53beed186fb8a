#include "freetalk/mesh/vertex_budget.h"

#include <OpenMesh/Tools/Decimater/DecimaterT.hh>
#include <OpenMesh/Tools/Decimater/ModNormalFlippingT.hh>
#include <OpenMesh/Tools/Decimater/ModQuadricT.hh>

#include <cmath>
#include <functional>
#include <utility>

#include "freetalk/core/error.h"
#include "mesh/surface_patch.h"

namespace freetalk::mesh {
namespace {

constexpr double kLength = 1e-4;     // of an edge's fourth power, beside the quadric error
constexpr double kFlipped = 60.0;    // degrees a face may turn
constexpr double kImportance = 5.0;  // power of an importance that a quadric error is worth

/// Quadric error, dearer where the surface matters; tells of every vertex that is to go.
class Thinning : public om::Decimater::ModQuadricT<Surface> {
 public:
  using Quadric = om::Decimater::ModQuadricT<Surface>;
  using Info = om::Decimater::CollapseInfoT<Surface>;
  using Quadric::Quadric;

  float collapse_priority(const Info& info) override {
    if (!allowed(info)) return ILLEGAL_COLLAPSE;
    const double length = (info.p1 - info.p0).sqrnorm();
    const double error = Quadric::collapse_priority(info) + kLength * length * length;
    return static_cast<float>(error * worth(info.v0));
  }
  void preprocess_collapse(const Info& info) override { going(info); }

  std::function<bool(const Info&)> allowed;
  std::function<double(Vertex)> worth;
  std::function<void(const Info&)> going;
};

/// Takes out vertices that no polygon has.
void drop_unused(const Eigen::Index old, Budgeted& made) {
  Eigen::MatrixXd& vertices = made.mesh.vertices;
  std::vector<int> now(static_cast<size_t>(vertices.rows()), -1);
  for (const std::vector<int>& polygon : made.mesh.polygons) {
    for (const int vertex : polygon) now[static_cast<size_t>(vertex)] = 0;
  }
  int count = 0;
  for (Eigen::Index v = 0; v < vertices.rows(); ++v) {
    if (now[static_cast<size_t>(v)] < 0) continue;
    vertices.row(count) = vertices.row(v).eval();
    now[static_cast<size_t>(v)] = count++;
  }
  vertices.conservativeResize(count, 3);
  for (std::vector<int>& polygon : made.mesh.polygons) {
    for (int& vertex : polygon) vertex = now[static_cast<size_t>(vertex)];
  }
  made.vertex_map.assign(now.begin(), now.begin() + old);
}

class Budget : public SurfacePatch {
 public:
  Budget(const Mesh& mesh, const Eigen::VectorXd& importance)
      : SurfacePatch(mesh, std::vector<bool>(static_cast<size_t>(mesh.num_polygons()), true)),
        importance_(surface_.n_vertices(), 1.0) {
    if (importance.size() == 0) return;
    for (const om::FaceHandle face : surface_.faces()) {
      for (const Corner& corner : corners_[static_cast<size_t>(face.idx())]) {
        importance_[static_cast<size_t>(corner.at.idx())] = importance[corner.vertex];
      }
    }
  }

  Budgeted result(int64_t wanted) {
    const int64_t before = used();
    if (wanted < before) thin_out(before - wanted);
    if (wanted > before) refine(wanted - before);
    Budgeted made;
    put_together(made);
    drop_unused(mesh_.num_vertices(), made);
    return made;
  }

 private:
  using Info = Thinning::Info;

  int64_t used() const {
    std::vector<bool> seen(static_cast<size_t>(mesh_.num_vertices()));
    for (const int vertex : mesh_.faces.reshaped()) seen[static_cast<size_t>(vertex)] = true;
    return std::count(seen.begin(), seen.end(), true);
  }

  Corner corner(om::FaceHandle face, Vertex at) {
    return corner_at(corners_[static_cast<size_t>(face.idx())], at);
  }

  /// Whether all faces have the same vertex and texture coordinate there.
  bool single(Vertex v) {
    std::set<std::pair<int, int>> found;
    for (const om::FaceHandle face : surface_.vf_range(v)) {
      const Corner own = corner(face, v);
      found.emplace(own.vertex, own.texcoord);
    }
    return found.size() == 1;
  }

  void thin_out(int64_t count) {
    // Kept beyond the decimater's life: they say what is gone.
    surface_.request_vertex_status();
    surface_.request_edge_status();
    surface_.request_face_status();
    surface_.request_face_normals();
    surface_.update_face_normals();
    for (const Vertex v : surface_.vertices()) {
      surface_.status(v).set_locked(surface_.is_boundary(v) || held(v) || !single(v));
    }
    om::Decimater::DecimaterT<Surface> decimater(surface_);
    om::Decimater::ModHandleT<Thinning> thinning;
    om::Decimater::ModNormalFlippingT<Surface>::Handle flipping;
    decimater.add(thinning);
    decimater.add(flipping);
    decimater.module(flipping).set_max_normal_deviation(kFlipped);
    auto& module = decimater.module(thinning);
    module.allowed = [this](const Info& info) {
      const Corner left = corner(info.fl, info.v1), right = corner(info.fr, info.v1);
      return left.vertex == right.vertex && left.texcoord == right.texcoord;
    };
    module.worth = [this](Vertex v) {
      return std::pow(importance_[static_cast<size_t>(v.idx())], kImportance);
    };
    module.going = [this](const Info& info) {
      const Corner stays = corner(info.fl, info.v1);
      for (const om::FaceHandle face : surface_.vf_range(info.v0)) {
        const auto index = static_cast<size_t>(face.idx());
        changed_[static_cast<size_t>(polygon_[index])] = true;
        if (face != info.fl && face != info.fr) corner_at(corners_[index], info.v0) = stays;
      }
    };
    if (!decimater.initialize()) return;
    decimater.decimate(static_cast<size_t>(count));
  }

  void refine(int64_t count) {
    const auto worth = [this](om::EdgeHandle edge) {
      const auto [a, b] = ends(edge);
      if (held(a) && held(b)) return 0.0;  // It may be another polygon's edge too.
      const double own = size(edge);
      for (const int side : {0, 1}) {  // Not the longest of a triangle: it would become a sliver.
        const om::HalfedgeHandle half = surface_.halfedge_handle(edge, side);
        if (surface_.is_boundary(half)) continue;
        const om::HalfedgeHandle next = surface_.next_halfedge_handle(half);
        for (const auto other : {next, surface_.next_halfedge_handle(next)}) {
          if (size(surface_.edge_handle(other)) > own * (1 + 1e-9)) return 0.0;
        }
      }
      return own;
    };
    const size_t most = added_.size() + static_cast<size_t>(count);
    halve_longest(worth, [&](om::EdgeHandle edge) {
      const auto [a, b] = ends(edge);
      importance_.push_back((importance_of(a) + importance_of(b)) / 2);
      return added_.size() < most;
    });
  }

  /// Length, and what it is worth.
  double size(om::EdgeHandle edge) const {
    const auto [a, b] = ends(edge);
    return surface_.calc_edge_length(edge) * (importance_of(a) + importance_of(b));
  }

  std::pair<Vertex, Vertex> ends(om::EdgeHandle edge) const {
    const om::HalfedgeHandle half = surface_.halfedge_handle(edge, 0);
    return {surface_.from_vertex_handle(half), surface_.to_vertex_handle(half)};
  }

  double importance_of(Vertex v) const { return importance_[static_cast<size_t>(v.idx())]; }

  std::vector<double> importance_;  // of each vertex of surface_
};

}  // namespace

Budgeted to_vertex_budget(const Mesh& mesh, int64_t vertices, const Eigen::VectorXd& importance) {
  FREETALK_CHECK(vertices > 0, "vertices must be positive, found ", vertices);
  FREETALK_CHECK(importance.size() == 0 || importance.size() == mesh.num_vertices(),
                 "expected an importance for each of ", mesh.num_vertices(), " vertices, found ",
                 importance.size());
  FREETALK_CHECK(importance.size() == 0 || (importance.array() > 0).all(),
                 "importance must be positive");
  Budgeted made = Budget(mesh, importance).result(vertices);
  made.mesh =
      make_mesh(std::move(made.mesh.vertices), std::move(made.mesh.polygons),
                std::move(made.mesh.texcoords), std::move(made.mesh.polygon_texcoords), mesh.name);
  return made;
}

}  // namespace freetalk::mesh
