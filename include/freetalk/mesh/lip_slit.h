// A slit between lips that are one closed skin, as those of a scan, and a pocket behind it.
#pragma once

#include <Eigen/Core>

#include <cstdint>

#include "freetalk/mesh/mesh.h"
#include "freetalk/mesh/reshaped.h"

namespace freetalk::mesh {

/// Whether upper and lower lip are one skin: the surface leads from below the nose to the chin
/// without going deeper than 10 mm behind the line between them.
/// @param vertices (V, 3) m, canonical frame. @param faces (F, 3). @param landmarks (68, 3) m.
/// @throws std::invalid_argument for other shapes.
bool lips_are_joined(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                     const Eigen::MatrixXd& landmarks);

struct SlitOptions {
  double edge = 1e-3;       // m: longer edges around the slit are halved
  double corridor = 0.004;  // m on either side of the inner lips' landmarks, in which they are
  double gap = 2e-5;        // m between the lips afterwards
  double depth = 0.03;      // m of the pocket; 0: none
  template <class V>
  void fields(V& v) {
    v("edge", edge);
    v("corridor", corridor);
    v("gap", gap);
    v("depth", depth);
  }
  /// @throws std::invalid_argument naming the option at fault.
  void check() const;
};

struct LipSlit : Reshaped {
  int64_t edges = 0;                                 ///< of the slit
  int64_t pocket_polygons = 0, pocket_vertices = 0;  ///< the last ones are those of the pocket
};

/// Cuts along the crease between the lips from corner to corner (landmarks 60 and 64), lowers the
/// lower lip's rim by `gap`, and sews a pocket to both rims. Edges around the slit are halved until
/// they are short, which changes no surface; texture coordinates follow.
/// @param mesh outward polygons, canonical frame, m. @param landmarks (68, 3) m.
/// @throws std::invalid_argument for options or shapes; std::runtime_error where the surface at the
/// lips cannot be cut.
LipSlit cut_lips(const Mesh& mesh, const Eigen::MatrixXd& landmarks,
                 const SlitOptions& options = {});

}  // namespace freetalk::mesh
