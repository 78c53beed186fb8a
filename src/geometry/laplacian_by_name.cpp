#include "laplacian_by_name.h"

namespace freetalk::geometry {

Regularization regularization_of(const OperatorOptions& options) {
  return options.regularization == "absolute" ? Regularization::kAbsolute
                                              : Regularization::kRelative;
}

Eigen::VectorXd with_floor(const Eigen::VectorXd& mass) {
  return mass.array() + 1e-8 * mass.mean();
}

LaplacianAndMass laplacian_by_name(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                   const OperatorOptions& options) {
  if (options.laplacian == "robust") {
    LaplacianAndMass robust = robust_laplacian(vertices, faces);
    robust.mass = with_floor(robust.mass);
    return robust;
  }
  return {cotan_laplacian(vertices, faces, regularization_of(options)),
          lumped_mass(vertices, faces)};
}

}  // namespace freetalk::geometry
