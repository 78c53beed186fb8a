#include <ATen/ATen.h>

#include <algorithm>

#include "core/deferred.h"
#include "freetalk/core/error.h"
#include "freetalk/geometry/operators.h"
#include "freetalk/mesh/weld.h"
#include "operators_faces.h"

namespace freetalk::geometry {

void attach_faces(SurfaceOperators& operators, const Eigen::MatrixXd& vertices,
                  const Eigen::MatrixXi& faces, bool welded) {
  if (faces.rows() == 0) return;  // A point cloud.
  operators.on_faces = core::defer([vertices, faces, welded] {
    return face_operators(
        vertices, faces,
        welded ? mesh::weld(vertices, faces, "coincident").vertex_of : Eigen::VectorXi());
  });
}

const FaceOperators& SurfaceOperators::faces() const {
  FREETALK_CHECK(on_faces != nullptr,
                 "these operators have no faces (a point cloud's); PoissonNet, Jacobian fields and "
                 "outputs at faces or edges need those of a triangle mesh");
  return on_faces->get();
}

SurfaceOperators SurfaceOperators::turned(const at::Tensor& rotation) const {
  FREETALK_CHECK(rotation.dim() == 2 && rotation.size(0) == 3 && rotation.size(1) == 3,
                 "turned: expected a rotation (3, 3), found ", rotation.sizes());
  const at::Tensor turn = rotation.to(normals.options());
  SurfaceOperators result = *this;  // all else is intrinsic
  result.normals = normals.matmul(turn.t());
  result.frames = frames.matmul(turn.t());
  if (on_faces) {
    result.on_faces = core::defer([faces = on_faces, turn] { return faces->get().turned(turn); });
  }
  return result;
}

SurfaceOperators concatenate(const std::vector<SurfaceOperators>& parts) {
  FREETALK_CHECK(!parts.empty(), "concatenate: expected operators of at least one mesh");
  std::vector<at::Tensor> mass, evals, evecs, normals, frames, residuals;
  std::vector<SparseOperator> gradients;
  std::vector<std::shared_ptr<const core::Deferred<FaceOperators>>> faces;
  SurfaceOperators result;
  result.offsets = {0};
  for (const SurfaceOperators& part : parts) {
    FREETALK_CHECK(part.offsets.empty(), "concatenate: a part is a batch already");
    FREETALK_CHECK(part.k_eig() == parts[0].k_eig(), "concatenate: expected ", parts[0].k_eig(),
                   " eigenpairs of every mesh, found ", part.k_eig());
    mass.push_back(part.mass);
    evals.push_back(part.evals);
    evecs.push_back(part.evecs);
    gradients.push_back(part.gradients);
    normals.push_back(part.normals);
    frames.push_back(part.frames);
    residuals.push_back(part.residuals);
    faces.push_back(part.on_faces);
    result.offsets.push_back(result.offsets.back() + part.num_vertices());
  }
  result.mass = at::cat(mass);
  result.evals = at::stack(evals);
  result.evecs = at::cat(evecs);
  result.normals = at::cat(normals);
  result.frames = at::cat(frames);
  result.residuals = at::stack(residuals);
  result.gradients = concatenate_gradients(gradients);
  if (std::find(faces.begin(), faces.end(), nullptr) == faces.end()) {
    result.on_faces = core::defer([faces] {
      std::vector<const FaceOperators*> each;
      for (const auto& part : faces) each.push_back(&part->get());
      return concatenate(each);
    });
  }
  return result;
}

}  // namespace freetalk::geometry
