#include "shifted_factor.h"

namespace freetalk::geometry {

bool ShiftedFactor::factorize(double shift) {
  SparseMatrix shifted = laplacian_;
  shifted.diagonal() += shift * mass_;
  return ldlt_.factorize(shifted);
}

int64_t ShiftedFactor::num_negative() const { return (ldlt_.pivots().array() < 0.0).count(); }

}  // namespace freetalk::geometry
