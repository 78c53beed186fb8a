// The surface around the lips as halfedges, to be refined and cut; the rest of the mesh stays as it
// is.
#pragma once

#include <Eigen/Core>
#include <OpenMesh/Core/Mesh/TriMesh_ArrayKernelT.hh>

#include <algorithm>
#include <array>
#include <map>
#include <set>
#include <utility>
#include <vector>

#include "freetalk/mesh/lip_slit.h"

namespace freetalk::mesh {

namespace om = OpenMesh;

struct LipTraits : om::DefaultTraits {
  using Point = om::Vec3d;
  using Normal = om::Vec3d;
};
using Surface = om::TriMesh_ArrayKernelT<LipTraits>;
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

/// Triangles within 50 mm of the lips, edges near them halved until they are short. What its faces
/// have in the mesh stays known, and put_together() makes a mesh of it again.
class LipPatch {
 public:
  /// @throws std::runtime_error where the surface is not manifold there.
  LipPatch(const Mesh& mesh, const Eigen::MatrixXd& landmarks, const SlitOptions& options);

 protected:
  /// From the line between the corners of the inner lips, m.
  double distance(const om::Vec3d& point) const;
  int new_vertex(const VertexOrigin& origin);
  /// @param share where, of the way along the edge's first halfedge.
  Vertex split(om::EdgeHandle edge, double share);
  void put_together(LipSlit& slit);

  const Mesh& mesh_;
  const SlitOptions& options_;
  std::vector<om::Vec3d> line_;  // from corner to corner of the inner lips
  Surface surface_;
  std::vector<Corners> corners_;  // of each face of surface_
  std::vector<int> polygon_;
  std::set<int> outside_, split_, below_;
  std::vector<VertexOrigin> added_;
  std::vector<Eigen::RowVector2d> new_texcoords_;

 private:
  void take_apart();
  /// Halves edges, the longest first.
  void refine();
  bool to_halve(om::EdgeHandle edge) const;
  int texcoord(int polygon, const std::vector<int>& ring, int vertex) const;
  Eigen::RowVector2d texture(int row) const;
  int texture_between(int a, int b, double share);
};

}  // namespace freetalk::mesh
