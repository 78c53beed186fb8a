#include "freetalk/geometry/sparse_cholesky.h"

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <vector>

#include "core/parallel.h"
#include "freetalk/core/error.h"

namespace freetalk::geometry {
namespace {

constexpr int64_t kBlock = 32;  // columns solved together: a row of them fills four cache lines

#define FREETALK_CLONES __attribute__((target_clones("avx512f", "avx2", "default")))

/// A unit lower triangular matrix by columns, its diagonal left out, and the D of L D L^T.
struct Triangle {
  std::vector<int64_t> offsets;
  std::vector<int> rows;
  std::vector<double> values;
  std::vector<double> inverse_diagonal;
};

/// x <- L^-T D^-1 L^-1 x for kBlock columns.
FREETALK_CLONES void solve_block(const Triangle& triangle, double* x) {
  const int64_t count = static_cast<int64_t>(triangle.inverse_diagonal.size());
  for (int64_t column = 0; column < count; ++column) {
    const double* source = x + column * kBlock;
    for (int64_t e = triangle.offsets[column]; e < triangle.offsets[column + 1]; ++e) {
      double* target = x + triangle.rows[e] * kBlock;
      const double value = triangle.values[e];
      for (int64_t c = 0; c < kBlock; ++c) target[c] -= value * source[c];
    }
  }
  for (int64_t column = count - 1; column >= 0; --column) {
    double* target = x + column * kBlock;
    double sum[kBlock];
    for (int64_t c = 0; c < kBlock; ++c) sum[c] = target[c] * triangle.inverse_diagonal[column];
    for (int64_t e = triangle.offsets[column]; e < triangle.offsets[column + 1]; ++e) {
      const double* source = x + triangle.rows[e] * kBlock;
      const double value = triangle.values[e];
      for (int64_t c = 0; c < kBlock; ++c) sum[c] -= value * source[c];
    }
    for (int64_t c = 0; c < kBlock; ++c) target[c] = sum[c];
  }
}

}  // namespace

struct SparseCholesky::Factor {
  Eigen::SimplicialLDLT<SparseMatrix> ldlt;
  Triangle triangle;
  std::vector<int> order;  // row of the factor -> row of the matrix

  void take() {
    FREETALK_RUNTIME_CHECK(ldlt.info() == Eigen::Success && (ldlt.vectorD().array() > 0.0).all(),
                           "sparse Cholesky: the matrix of size ", ldlt.rows(),
                           " is not positive definite");
    const auto& lower = ldlt.matrixL().nestedExpression();
    triangle.offsets.assign(1, 0);
    triangle.rows.clear();
    triangle.values.clear();
    for (int column = 0; column < lower.cols(); ++column) {
      for (Eigen::SparseMatrix<double>::InnerIterator entry(lower, column); entry; ++entry) {
        if (entry.row() <= column) continue;
        triangle.rows.push_back(static_cast<int>(entry.row()));
        triangle.values.push_back(entry.value());
      }
      triangle.offsets.push_back(static_cast<int64_t>(triangle.rows.size()));
    }
    const Eigen::VectorXd inverse = ldlt.vectorD().cwiseInverse();
    triangle.inverse_diagonal.assign(inverse.data(), inverse.data() + inverse.size());
    const auto& indices = ldlt.permutationPinv().indices();
    order.assign(indices.data(), indices.data() + indices.size());
  }
};

SparseCholesky::SparseCholesky(const SparseMatrix& matrix) : factor_(std::make_unique<Factor>()) {
  FREETALK_CHECK(matrix.rows() == matrix.cols() && matrix.rows() > 0,
                 "sparse Cholesky: expected a square matrix, found ", matrix.rows(), " x ",
                 matrix.cols());
  factor_->ldlt.analyzePattern(matrix);
  refactor(matrix);
}

SparseCholesky::~SparseCholesky() = default;
SparseCholesky::SparseCholesky(SparseCholesky&&) noexcept = default;
SparseCholesky& SparseCholesky::operator=(SparseCholesky&&) noexcept = default;

void SparseCholesky::refactor(const SparseMatrix& matrix) {
  factor_->ldlt.factorize(matrix);
  factor_->take();
}

void SparseCholesky::solve(double* x, int64_t num_columns) const {
  const int64_t count = static_cast<int64_t>(factor_->order.size());
  const int64_t blocks = (num_columns + kBlock - 1) / kBlock;
  core::parallel_for(0, blocks, 1, [&](int64_t begin, int64_t end) {
    std::vector<double> work(static_cast<size_t>(count * kBlock), 0.0);
    for (int64_t block = begin; block < end; ++block) {
      const int64_t first = block * kBlock, width = std::min(kBlock, num_columns - first);
      for (int64_t row = 0; row < count; ++row) {
        std::copy_n(x + factor_->order[row] * num_columns + first, width,
                    work.data() + row * kBlock);
      }
      solve_block(factor_->triangle, work.data());
      for (int64_t row = 0; row < count; ++row) {
        std::copy_n(work.data() + row * kBlock, width,
                    x + factor_->order[row] * num_columns + first);
      }
    }
  });
}

}  // namespace freetalk::geometry
