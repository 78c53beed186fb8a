#include "shifted_factor.h"

namespace freetalk::geometry {
namespace {

SparseMatrix shifted(const SparseMatrix& laplacian, const Eigen::VectorXd& mass, double shift) {
  SparseMatrix matrix = laplacian;
  matrix.diagonal() += shift * mass;
  return matrix;
}

}  // namespace

ShiftedFactor::ShiftedFactor(const SparseMatrix& laplacian, const Eigen::VectorXd& mass)
    : laplacian_(laplacian), mass_(mass) {
  factor_.analyzePattern(laplacian);
  order_ = factor_.permutationP().indices();
}

bool ShiftedFactor::factorize(double shift) {
  factor_.factorize(shifted(laplacian_, mass_, shift));
  if (factor_.info() != Eigen::Success) return false;
  inverse_pivots_ = factor_.vectorD().cwiseInverse();
  return inverse_pivots_.allFinite();
}

void ShiftedFactor::solve(TallBlock& x) const {
  const SparseMatrix& lower = factor_.matrixL().nestedExpression();
  const UnitLower view{lower.cols(), lower.outerIndexPtr(), lower.innerIndexPtr(),
                       lower.valuePtr()};
  const BlockKernels& kernels = kernels::block_kernels();
  kernels.solve_lower(view, x.data());
  kernels.solve_upper(view, inverse_pivots_.data(), x.data());
}

int64_t ShiftedFactor::num_negative() const { return (inverse_pivots_.array() < 0.0).count(); }

}  // namespace freetalk::geometry
