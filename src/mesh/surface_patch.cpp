#include "mesh/surface_patch.h"

#include <map>
#include <queue>
#include <tuple>
#include <utility>

#include "freetalk/mesh/components.h"

namespace freetalk::mesh {

SurfacePatch::SurfacePatch(const Mesh& mesh, std::vector<bool> taken)
    : mesh_(mesh), changed_(taken.size()), taken_(std::move(taken)) {
  for (bool whole = false; !whole;) {
    const auto before = std::count(taken_.begin(), taken_.end(), true);
    take_apart();
    whole = std::count(taken_.begin(), taken_.end(), true) == before;
    manifold_ = manifold_ && whole;
  }
}

int SurfacePatch::new_vertex(const VertexOrigin& origin) {
  added_.push_back(origin);
  return static_cast<int>(mesh_.num_vertices() + static_cast<int64_t>(added_.size()) - 1);
}

/// Polygons that cannot be added are no longer taken.
void SurfacePatch::take_apart() {
  surface_.clear();
  corners_.clear();
  polygon_.clear();
  const Eigen::VectorXi first = coincident_vertices(mesh_.vertices);
  std::map<int, Vertex> at;
  Corners corners;
  for (Eigen::Index f = 0; f < mesh_.num_faces(); ++f) {
    const int polygon = mesh_.face_polygon[static_cast<size_t>(f)];
    if (!takes(polygon)) continue;
    const std::vector<int> ring = mesh_.polygon(polygon);
    for (int k = 0; k < 3; ++k) {
      const int v = mesh_.faces(f, k);
      const auto [entry, made] = at.try_emplace(first[v]);
      if (made) entry->second = surface_.add_vertex(vec(mesh_.vertices.row(v)));
      corners[static_cast<size_t>(k)] = {entry->second, v, texcoord(polygon, ring, v)};
    }
    if (corners[0].at == corners[1].at || corners[1].at == corners[2].at ||
        corners[2].at == corners[0].at) {
      continue;
    }
    if (!fits(corners)) {
      taken_[static_cast<size_t>(polygon)] = false;
      continue;
    }
    surface_.add_face(corners[0].at, corners[1].at, corners[2].at);
    corners_.push_back(corners);
    polygon_.push_back(polygon);
  }
  held_.clear();
  for (Eigen::Index f = 0; f < mesh_.num_faces(); ++f) {
    if (takes(mesh_.face_polygon[static_cast<size_t>(f)])) continue;
    for (int k = 0; k < 3; ++k) {
      const auto found = at.find(first[mesh_.faces(f, k)]);
      if (found != at.end()) held_.insert(found->second);
    }
  }
}

bool SurfacePatch::fits(const Corners& corners) const {
  for (size_t k = 0; k < 3; ++k) {
    const Vertex a = corners[k].at, b = corners[(k + 1) % 3].at;
    if (!surface_.is_isolated(a) && !surface_.is_boundary(a)) return false;
    const om::HalfedgeHandle edge = surface_.find_halfedge(a, b);
    if (!edge.is_valid()) continue;
    if (!surface_.is_boundary(edge)) return false;
    const om::HalfedgeHandle back = surface_.opposite_halfedge_handle(edge);
    if (surface_.opposite_vh(back) == corners[(k + 2) % 3].at) return false;  // its other side
  }
  return true;
}

int SurfacePatch::texcoord(int polygon, const std::vector<int>& ring, int vertex) const {
  if (mesh_.polygon_texcoords.empty()) return -1;
  const auto& own = mesh_.polygon_texcoords[static_cast<size_t>(polygon)];
  const auto at = std::find(ring.begin(), ring.end(), vertex) - ring.begin();
  return static_cast<size_t>(at) < own.size() ? own[static_cast<size_t>(at)] : -1;
}

Vertex SurfacePatch::split(om::EdgeHandle edge, double share) {
  const om::HalfedgeHandle half = surface_.halfedge_handle(edge, 0);
  const Vertex a = surface_.from_vertex_handle(half), b = surface_.to_vertex_handle(half);
  std::map<Vertex, std::pair<Corners, int>> parents;  // by the vertex across the edge
  for (const om::HalfedgeHandle side : {half, surface_.opposite_halfedge_handle(half)}) {
    if (surface_.is_boundary(side)) continue;
    const auto face = static_cast<size_t>(surface_.face_handle(side).idx());
    parents[surface_.opposite_vh(side)] = {corners_[face], polygon_[face]};
  }
  const Vertex middle =
      surface_.add_vertex(surface_.point(a) * (1 - share) + surface_.point(b) * share);
  surface_.split(edge, middle);
  corners_.resize(surface_.n_faces());
  polygon_.resize(surface_.n_faces());
  std::map<std::pair<int, int>, int> vertices, textures;
  for (const om::FaceHandle face : surface_.vf_range(middle)) {
    const auto index = static_cast<size_t>(face.idx());
    bool has_a = false;
    for (const Vertex v : surface_.fv_range(face)) {
      has_a = has_a || v == a;
      const auto parent = parents.find(v);
      if (parent != parents.end()) {
        std::tie(corners_[index], polygon_[index]) = parent->second;
      }
    }
    const Corner from = corner_at(corners_[index], a), to = corner_at(corners_[index], b);
    Corner& gone = corner_at(corners_[index], has_a ? b : a);
    gone.at = middle;
    const auto [vertex, made] = vertices.try_emplace({from.vertex, to.vertex});
    if (made) vertex->second = new_vertex({from.vertex, to.vertex, share});
    gone.vertex = vertex->second;
    if (from.texcoord < 0 || to.texcoord < 0) {
      gone.texcoord = -1;
      continue;
    }
    const auto [texture, first] = textures.try_emplace({from.texcoord, to.texcoord});
    if (first) texture->second = texture_between(from.texcoord, to.texcoord, share);
    gone.texcoord = texture->second;
  }
  for (auto& [across, parent] : parents) changed_[static_cast<size_t>(parent.second)] = true;
  return middle;
}

void SurfacePatch::halve_longest(const std::function<double(om::EdgeHandle)>& worth,
                                 const std::function<bool(om::EdgeHandle)>& halving) {
  std::priority_queue<std::pair<double, int>> queue;
  const auto push = [&](om::EdgeHandle edge) {
    const double own = worth(edge);
    if (own > 0) queue.emplace(own, edge.idx());
  };
  for (const om::EdgeHandle edge : surface_.edges()) push(edge);
  while (!queue.empty()) {
    const auto [queued, index] = queue.top();
    queue.pop();
    const om::EdgeHandle edge(index);
    if (worth(edge) < queued * (1 - 1e-9)) continue;  // halved since
    if (halving && !halving(edge)) return;
    const Vertex middle = split(edge, 0.5);
    for (const om::FaceHandle face : surface_.vf_range(middle)) {
      for (const om::EdgeHandle each : surface_.fe_range(face)) push(each);
    }
  }
}

Eigen::RowVector2d SurfacePatch::texture(int row) const {
  const auto own = static_cast<int>(mesh_.texcoords.rows());
  return row < own ? Eigen::RowVector2d(mesh_.texcoords.row(row))
                   : new_texcoords_[static_cast<size_t>(row - own)];
}

int SurfacePatch::texture_between(int a, int b, double share) {
  new_texcoords_.push_back((1 - share) * texture(a) + share * texture(b));
  return static_cast<int>(mesh_.texcoords.rows()) + static_cast<int>(new_texcoords_.size()) - 1;
}

void SurfacePatch::put_together(Reshaped& result) {
  Mesh& made = result.mesh;
  result.added = added_;
  const auto old = mesh_.num_vertices();
  Eigen::MatrixXd vertices(old + static_cast<Eigen::Index>(added_.size()), 3);
  vertices.topRows(old) = mesh_.vertices;
  for (size_t i = 0; i < added_.size(); ++i) {
    const auto& [a, b, share] = added_[i];
    const auto row = old + static_cast<Eigen::Index>(i);
    vertices.row(row) = (1 - share) * vertices.row(a) + share * vertices.row(b);
  }
  made.vertices = std::move(vertices);
  const auto own = mesh_.texcoords.rows();
  made.texcoords = mesh_.texcoords;
  made.texcoords.conservativeResize(own + static_cast<Eigen::Index>(new_texcoords_.size()), 2);
  for (size_t i = 0; i < new_texcoords_.size(); ++i) {
    made.texcoords.row(own + static_cast<Eigen::Index>(i)) = new_texcoords_[i];
  }
  made.name = mesh_.name;
  for (int p = 0; p < mesh_.num_polygons(); ++p) {
    if (changed_[static_cast<size_t>(p)]) continue;
    made.polygons.push_back(mesh_.polygon(p));
    if (own > 0) made.polygon_texcoords.push_back(mesh_.polygon_texcoords[static_cast<size_t>(p)]);
    result.polygon_origin.push_back(p);
  }
  for (const om::FaceHandle face : surface_.faces()) {
    const auto index = static_cast<size_t>(face.idx());
    if (!changed_[static_cast<size_t>(polygon_[index])]) continue;
    std::vector<int> polygon, texture;
    for (const Vertex v : surface_.fv_range(face)) {
      const Corner& corner = corner_at(corners_[index], v);
      polygon.push_back(corner.vertex);
      if (corner.texcoord >= 0) texture.push_back(corner.texcoord);
    }
    if (texture.size() < 3) texture.clear();
    made.polygons.push_back(polygon);
    if (own > 0) made.polygon_texcoords.push_back(texture);
    result.polygon_origin.push_back(polygon_[index]);
  }
}

}  // namespace freetalk::mesh
