// Which parts of a head mesh move, and with what: the skin by STM, the rest after it.
//
// Parts are the connected components of the mesh. In the canonical frame (metres, +Y up, +Z out of
// the face) they are told apart by where they lie relative to the template's 68 landmarks, their
// size and shape:
//   eyeballs          spheres of 8-18 mm radius at the eyes, and round pieces inside them: still;
//                     lids slide over them
//   teeth, gums, tongue  behind the lips: above the occlusal plane still, below it rigid with the
//   jaw; a part that
//                     holds both is divided by its own connectivity
//   lashes, brows, hair, beard  small or off the face: follow the skin at their roots, less the
//   farther they reach skin              what is left, at least 3 % of the largest part: driven by
//   STM
#pragma once

#include <ATen/core/Tensor.h>
#include <Eigen/Core>

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace freetalk::animation {

enum class PartMotion { kFace, kSurface, kJaw, kStill };

struct Part {
  PartMotion motion = PartMotion::kFace;
  int64_t num_vertices = 0;
};

/// The vertex sums of a sparse map: row v holds indices[starts[v]] ... indices[starts[v + 1] - 1].
struct Binding {
  std::vector<int64_t> starts;
  std::vector<int32_t> indices;
  std::vector<float> weights;
};

class Eyeball;

class Parts {
 public:
  /// @param vertices (V, 3) m, canonical frame. @param faces (F, 3). @param landmarks (68, 3) m,
  /// the template's.
  Parts(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
        const Eigen::MatrixXd& landmarks);

  /// One entry per component, in order of first vertex (vertices doubled along texture seams count
  /// as joined).
  const std::vector<Part>& parts() const { return parts_; }
  /// (V,) index into parts().
  const std::vector<int>& part_of_vertex() const { return part_of_vertex_; }
  /// (V,) share of the jaw's motion in [0, 1].
  const std::vector<float>& jaw_share() const { return jaw_share_; }

  /// The skin as one surface of its own: vertices (Vf, 3) m and faces (Ff, 3). Seams are closed.
  const Eigen::MatrixXd& face_vertices() const { return face_vertices_; }
  const Eigen::MatrixXi& face_faces() const { return face_faces_; }

  /// Displacements of the whole mesh from those of the skin.
  /// @param face_displacements (t, Vf, 3) float32 m. @param landmarks (t, 68, 3) float32 m,
  /// displacements.
  /// @return (t, V, 3) float32 m
  at::Tensor move(const at::Tensor& face_displacements, const at::Tensor& landmarks) const;

  /// "skin 14062, jaw 2031, still 3310, following 1452 vertices"
  std::string summary() const;

 private:
  Eigen::MatrixXd vertices_, landmarks_, face_vertices_;
  Eigen::MatrixXi face_faces_;
  std::vector<Part> parts_;
  std::vector<int> part_of_vertex_;
  std::vector<float> jaw_share_;
  Binding binding_;  // (V, Vf)
  std::shared_ptr<const std::vector<Eyeball>> eyeballs_;
};

}  // namespace freetalk::animation
