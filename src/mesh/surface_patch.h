// Some polygons of a mesh as halfedges, to be refined, thinned out or cut; the others stay as they
// are.
#pragma once

#include <Eigen/Core>
#include <OpenMesh/Core/Mesh/TriMesh_ArrayKernelT.hh>

#include <algorithm>
#include <array>
#include <functional>
#include <set>
#include <vector>

#include "freetalk/mesh/reshaped.h"

namespace freetalk::mesh {

namespace om = OpenMesh;

struct PatchTraits : om::DefaultTraits {
  using Point = om::Vec3d;
  using Normal = om::Vec3d;
};
using Surface = om::TriMesh_ArrayKernelT<PatchTraits>;
using Vertex = om::VertexHandle;

/// What a corner of a triangle has in the mesh: its vertex and texture coordinate (-1: none).
struct Corner {
  Vertex at;
  int vertex = 0, texcoord = -1;
};
using Corners = std::array<Corner, 3>;

inline Corner& corner_at(Corners& corners, Vertex at) {
  return *std::find_if(corners.begin(), corners.end(), [&](const auto& c) { return c.at == at; });
}

inline om::Vec3d vec(const Eigen::RowVector3d& row) { return {row[0], row[1], row[2]}; }

/// The triangles of polygons whose vertices at one place are one. What its faces have in the mesh
/// stays known, and put_together() makes a mesh of it again.
class SurfacePatch {
 public:
  /// @param taken (P,) the polygons that are wanted; those that make the surface branch are left
  /// out.
  SurfacePatch(const Mesh& mesh, std::vector<bool> taken);

 protected:
  /// Whether no polygon was left out for the way it hangs together.
  bool manifold() const { return manifold_; }
  /// Whether a polygon that was left out has this vertex too.
  bool held(Vertex v) const { return held_.contains(v); }

  int new_vertex(const VertexOrigin& origin);
  /// @param share where, of the way along the edge's first halfedge.
  Vertex split(om::EdgeHandle edge, double share);
  /// Halves edges, those of the greatest worth first, until none has any.
  /// @param halving asked before each; false ends it.
  void halve_longest(const std::function<double(om::EdgeHandle)>& worth,
                     const std::function<bool(om::EdgeHandle)>& halving = {});
  void put_together(Reshaped& made);

  const Mesh& mesh_;
  Surface surface_;
  std::vector<Corners> corners_;  // of each face of surface_
  std::vector<int> polygon_;
  std::vector<bool> changed_;  // polygons whose triangles take their place
  std::vector<VertexOrigin> added_;

 private:
  bool takes(int polygon) const { return taken_[static_cast<size_t>(polygon)]; }
  void take_apart();
  /// Whether a face can be added without the surface branching.
  bool fits(const Corners& corners) const;
  int texcoord(int polygon, const std::vector<int>& ring, int vertex) const;
  Eigen::RowVector2d texture(int row) const;
  int texture_between(int a, int b, double share);

  std::vector<bool> taken_;
  bool manifold_ = true;
  std::set<Vertex> held_;
  std::vector<Eigen::RowVector2d> new_texcoords_;
};

}  // namespace freetalk::mesh
