// A mesh of about as many vertices as wanted, most of them where they matter.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <vector>

#include "freetalk/mesh/reshaped.h"

namespace freetalk::mesh {

/// The vertices that are left in their order and place, then new ones.
struct Budgeted : Reshaped {
  std::vector<int> vertex_map;  ///< (V,) the new vertex of each old one, -1 where it is gone
};

/// Thins a mesh out by quadric error [Garland and Heckbert 1997, "Surface simplification using
/// quadric error metrics"], or halves its longest edges, which changes no surface. What is changed
/// comes out in triangles. Texture coordinates follow; rims, seams of textures and polygons where
/// the surface branches are not thinned out, so that more vertices may be left than wanted.
/// @param vertices wanted, > 0. @param importance (V,) of an edge's ends, > 0: edges that are worth
/// as many times as much are as many times shorter; empty for the same everywhere.
/// @throws std::invalid_argument for arguments of another form.
Budgeted to_vertex_budget(const Mesh& mesh, int64_t vertices,
                          const Eigen::VectorXd& importance = {});

}  // namespace freetalk::mesh
