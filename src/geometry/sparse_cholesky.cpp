#include "freetalk/geometry/sparse_cholesky.h"

#include <algorithm>

#include "core/parallel.h"
#include "freetalk/core/error.h"
#include "sparse_ldlt.h"

namespace freetalk::geometry {

struct SparseCholesky::Factor {
  SparseLdlt ldlt;
};

SparseCholesky::SparseCholesky(const SparseMatrix& matrix) {
  FREETALK_CHECK(matrix.rows() == matrix.cols() && matrix.rows() > 0,
                 "sparse Cholesky: expected a square matrix, found ", matrix.rows(), " x ",
                 matrix.cols());
  factor_ = std::make_unique<Factor>(SparseLdlt(matrix));
  refactor(matrix);
}

SparseCholesky::~SparseCholesky() = default;
SparseCholesky::SparseCholesky(SparseCholesky&&) noexcept = default;
SparseCholesky& SparseCholesky::operator=(SparseCholesky&&) noexcept = default;

void SparseCholesky::refactor(const SparseMatrix& matrix) {
  const bool regular = factor_->ldlt.factorize(matrix);
  FREETALK_RUNTIME_CHECK(regular && factor_->ldlt.pivots().minCoeff() > 0.0,
                         "sparse Cholesky: the matrix of size ", matrix.rows(),
                         " is not positive definite");
}

void SparseCholesky::solve(double* x, int64_t num_columns) const {
  using kernels::kBlockWidth;
  const SparseLdlt& ldlt = factor_->ldlt;
  const Eigen::VectorXi& position = ldlt.position();
  const int64_t blocks = (num_columns + kBlockWidth - 1) / kBlockWidth;
  core::parallel_for(0, blocks, 1, [&](int64_t begin, int64_t end) {
    kernels::TallBlock work(ldlt.solve_rows());
    for (int64_t block = begin; block < end; ++block) {
      const int64_t first = block * kBlockWidth, width = std::min(kBlockWidth, num_columns - first);
      for (int64_t row = 0; row < ldlt.size(); ++row) {
        double* target = work.row(position[row]);
        std::fill_n(target, kBlockWidth, 0.0);
        std::copy_n(x + row * num_columns + first, width, target);
      }
      ldlt.solve(work);
      for (int64_t row = 0; row < ldlt.size(); ++row) {
        std::copy_n(work.row(position[row]), width, x + row * num_columns + first);
      }
    }
  });
}

}  // namespace freetalk::geometry
