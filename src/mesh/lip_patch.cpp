#include "mesh/lip_patch.h"

#include <limits>
#include <queue>
#include <tuple>

#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "freetalk/mesh/components.h"

namespace freetalk::mesh {
namespace {

constexpr double kRegion = 0.05;  // m around the middle of the lips that is taken apart

}  // namespace

LipPatch::LipPatch(const Mesh& mesh, const Eigen::MatrixXd& landmarks, const SlitOptions& options)
    : mesh_(mesh), options_(options) {
  line_.push_back(vec(landmarks.row(60)));
  for (const auto& [upper, lower] : core::kInnerLips) {
    line_.push_back(vec((landmarks.row(upper) + landmarks.row(lower)) / 2));
  }
  line_.push_back(vec(landmarks.row(64)));
  take_apart();
  refine();
}

double LipPatch::distance(const om::Vec3d& point) const {
  double least = std::numeric_limits<double>::infinity();
  for (size_t i = 0; i + 1 < line_.size(); ++i) {
    const om::Vec3d along = line_[i + 1] - line_[i];
    const double share = ((point - line_[i]) | along) / std::max(along.sqrnorm(), 1e-18);
    least = std::min(least, (point - line_[i] - along * std::clamp(share, 0.0, 1.0)).norm());
  }
  return least;
}

int LipPatch::new_vertex(const VertexOrigin& origin) {
  added_.push_back(origin);
  return static_cast<int>(mesh_.num_vertices() + static_cast<int64_t>(added_.size()) - 1);
}

void LipPatch::take_apart() {
  const Eigen::VectorXi first = coincident_vertices(mesh_.vertices);
  std::map<int, Vertex> taken;
  const om::Vec3d middle = line_[2];
  for (Eigen::Index f = 0; f < mesh_.num_faces(); ++f) {
    const int polygon = mesh_.face_polygon[static_cast<size_t>(f)];
    bool near = true;
    for (int k = 0; k < 3; ++k) {
      near = near && (vec(mesh_.vertices.row(mesh_.faces(f, k))) - middle).norm() < kRegion;
    }
    // Polygons are taken whole or not at all.
    if (!near) outside_.insert(polygon);
  }
  Corners corners;
  for (Eigen::Index f = 0; f < mesh_.num_faces(); ++f) {
    const int polygon = mesh_.face_polygon[static_cast<size_t>(f)];
    if (outside_.contains(polygon)) continue;
    const std::vector<int> ring = mesh_.polygon(polygon);
    for (int k = 0; k < 3; ++k) {
      const int v = mesh_.faces(f, k);
      const auto [entry, made] = taken.try_emplace(first[v]);
      if (made) entry->second = surface_.add_vertex(vec(mesh_.vertices.row(v)));
      corners[static_cast<size_t>(k)] = {entry->second, v, texcoord(polygon, ring, v)};
    }
    if (corners[0].at == corners[1].at || corners[1].at == corners[2].at ||
        corners[2].at == corners[0].at) {
      continue;
    }
    const om::FaceHandle face = surface_.add_face(corners[0].at, corners[1].at, corners[2].at);
    FREETALK_RUNTIME_CHECK(face.is_valid(), mesh_.name,
                           ": the surface around the lips is not manifold, so no slit is cut; "
                           "drop duplicate and floating polygons first");
    corners_.push_back(corners);
    polygon_.push_back(polygon);
  }
}

int LipPatch::texcoord(int polygon, const std::vector<int>& ring, int vertex) const {
  if (mesh_.polygon_texcoords.empty()) return -1;
  const auto& own = mesh_.polygon_texcoords[static_cast<size_t>(polygon)];
  const auto at = std::find(ring.begin(), ring.end(), vertex) - ring.begin();
  return static_cast<size_t>(at) < own.size() ? own[static_cast<size_t>(at)] : -1;
}

bool LipPatch::to_halve(om::EdgeHandle edge) const {
  if (surface_.is_boundary(edge) || surface_.calc_edge_length(edge) <= options_.edge) return false;
  const om::HalfedgeHandle half = surface_.halfedge_handle(edge, 0);
  const om::Vec3d a = surface_.point(surface_.from_vertex_handle(half));
  const om::Vec3d b = surface_.point(surface_.to_vertex_handle(half));
  for (const double share : {0.0, 0.25, 0.5, 0.75, 1.0}) {
    if (distance(a * (1 - share) + b * share) < options_.corridor) return true;
  }
  return false;
}

void LipPatch::refine() {
  std::priority_queue<std::pair<double, int>> queue;
  const auto push = [&](om::EdgeHandle edge) {
    if (to_halve(edge)) queue.emplace(surface_.calc_edge_length(edge), edge.idx());
  };
  for (const om::EdgeHandle edge : surface_.edges()) push(edge);
  while (!queue.empty()) {
    const auto [length, index] = queue.top();
    queue.pop();
    const om::EdgeHandle edge(index);
    if (surface_.calc_edge_length(edge) < length * (1 - 1e-9)) continue;  // halved since
    const Vertex middle = split(edge, 0.5);
    for (const om::EdgeHandle each : surface_.ve_range(middle)) push(each);
  }
}

Vertex LipPatch::split(om::EdgeHandle edge, double share) {
  const om::HalfedgeHandle half = surface_.halfedge_handle(edge, 0);
  const Vertex a = surface_.from_vertex_handle(half), b = surface_.to_vertex_handle(half);
  std::map<Vertex, std::pair<Corners, int>> parents;  // by the vertex across the edge
  for (const om::HalfedgeHandle side : {half, surface_.opposite_halfedge_handle(half)}) {
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
  for (auto& [across, parent] : parents) split_.insert(parent.second);
  return middle;
}

Eigen::RowVector2d LipPatch::texture(int row) const {
  const auto own = static_cast<int>(mesh_.texcoords.rows());
  return row < own ? Eigen::RowVector2d(mesh_.texcoords.row(row))
                   : new_texcoords_[static_cast<size_t>(row - own)];
}

int LipPatch::texture_between(int a, int b, double share) {
  new_texcoords_.push_back((1 - share) * texture(a) + share * texture(b));
  return static_cast<int>(mesh_.texcoords.rows()) + static_cast<int>(new_texcoords_.size()) - 1;
}

void LipPatch::put_together(LipSlit& slit) {
  Mesh& made = slit.mesh;
  const auto old = mesh_.num_vertices();
  Eigen::MatrixXd vertices(old + static_cast<Eigen::Index>(added_.size()), 3);
  vertices.topRows(old) = mesh_.vertices;
  for (size_t i = 0; i < added_.size(); ++i) {
    const auto& [a, b, share] = added_[i];
    const auto row = old + static_cast<Eigen::Index>(i);
    vertices.row(row) = (1 - share) * vertices.row(a) + share * vertices.row(b);
  }
  for (const int v : below_) vertices(v, 1) -= options_.gap;
  made.vertices = std::move(vertices);
  const auto own = mesh_.texcoords.rows();
  made.texcoords = mesh_.texcoords;
  made.texcoords.conservativeResize(own + static_cast<Eigen::Index>(new_texcoords_.size()), 2);
  for (size_t i = 0; i < new_texcoords_.size(); ++i) {
    made.texcoords.row(own + static_cast<Eigen::Index>(i)) = new_texcoords_[i];
  }
  made.name = mesh_.name;
  for (int p = 0; p < mesh_.num_polygons(); ++p) {
    if (split_.contains(p)) continue;
    made.polygons.push_back(mesh_.polygon(p));
    if (own > 0) made.polygon_texcoords.push_back(mesh_.polygon_texcoords[static_cast<size_t>(p)]);
    slit.polygon_origin.push_back(p);
  }
  for (const om::FaceHandle face : surface_.faces()) {
    const auto index = static_cast<size_t>(face.idx());
    if (!split_.contains(polygon_[index])) continue;
    std::vector<int> polygon, texture;
    for (const Vertex v : surface_.fv_range(face)) {
      const Corner& corner = corner_at(corners_[index], v);
      polygon.push_back(corner.vertex);
      if (corner.texcoord >= 0) texture.push_back(corner.texcoord);
    }
    if (texture.size() < 3) texture.clear();
    made.polygons.push_back(polygon);
    if (own > 0) made.polygon_texcoords.push_back(texture);
    slit.polygon_origin.push_back(polygon_[index]);
  }
}

}  // namespace freetalk::mesh
