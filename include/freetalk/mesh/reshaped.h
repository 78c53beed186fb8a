// A mesh made of another one, and whose look its polygons and vertices have.
#pragma once

#include <vector>

#include "freetalk/mesh/mesh.h"

namespace freetalk::mesh {

/// Between two vertices of the given mesh and those added before: (1 - share) a + share b.
struct VertexOrigin {
  int a = 0, b = 0;
  double share = 0.0;
};

struct Reshaped {
  Mesh mesh;                        ///< the given vertices in their order and place, then new ones
  std::vector<int> polygon_origin;  ///< (P',) the given polygon whose look each has
  std::vector<VertexOrigin> added;  ///< of the new vertices: whose look each has
};

}  // namespace freetalk::mesh
