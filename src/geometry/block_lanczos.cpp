#include "block_lanczos.h"
#include "core/parallel.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include <algorithm>
#include <cmath>
#include <limits>

#include "freetalk/core/random.h"

namespace freetalk::geometry {
namespace {

using Small = BlockLanczos::Small;
using RowMajorMatrix = Eigen::Matrix<double, Eigen::Dynamic, kBlockWidth, Eigen::RowMajor>;

constexpr int64_t kChunkRows = 1024;  // Work is cut by rows alone: sums do not depend on threads.
constexpr int64_t kTileRows = 128;    // A tile of a block stays in the nearest cache.

int64_t num_chunks(int64_t rows) { return (rows + kChunkRows - 1) / kChunkRows; }

/// Calls body(begin, end, chunk) for each chunk of rows.
template <class Body>
void for_chunks(int64_t rows, const Body& body) {
  core::parallel_for(0, num_chunks(rows), 1, [&](int64_t first, int64_t last) {
    for (int64_t chunk = first; chunk < last; ++chunk) {
      body(chunk * kChunkRows, std::min(rows, (chunk + 1) * kChunkRows), chunk);
    }
  });
}

using Blocks = std::vector<const TallBlock*>;
using Targets = std::vector<TallBlock*>;

/// blocks[j]^T targets[t] at [t * blocks.size() + j]. Each tile of a block is read once for all
/// targets.
std::vector<Small> grams(const Blocks& blocks, const Blocks& targets) {
  const BlockKernels& kernels = kernels::block_kernels();
  const int64_t num_rows = targets[0]->rows();
  const size_t count = blocks.size() * targets.size();
  std::vector<std::vector<Small>> partial(static_cast<size_t>(num_chunks(num_rows)));
  for_chunks(num_rows, [&](int64_t begin, int64_t end, int64_t chunk) {
    std::vector<Small>& sums = partial[static_cast<size_t>(chunk)];
    sums.assign(count, Small::Zero());
    alignas(64) Small sum;
    for (int64_t r = begin; r < end; r += kTileRows) {
      const int64_t rows = std::min(kTileRows, end - r);
      for (size_t j = 0; j < blocks.size(); ++j) {
        for (size_t t = 0; t < targets.size(); ++t) {
          Small& total = sums[t * blocks.size() + j];
          sum = total;
          kernels.add_gram(blocks[j]->row(r), targets[t]->row(r), rows, sum.data());
          total = sum;
        }
      }
    }
  });
  std::vector<Small> result(count, Small::Zero());
  for (const std::vector<Small>& sums : partial) {
    for (size_t i = 0; i < count; ++i) result[i] += sums[i];
  }
  return result;
}

Small gram(const TallBlock& a, const TallBlock& b) { return grams({&a}, {&b})[0]; }

/// targets[t] -= sum_j blocks[j] factors[t * blocks.size() + j].
void subtract(const Blocks& blocks, const std::vector<Small>& factors, const Targets& targets) {
  const BlockKernels& kernels = kernels::block_kernels();
  for_chunks(targets[0]->rows(), [&](int64_t begin, int64_t end, int64_t) {
    alignas(64) Small factor;
    for (int64_t r = begin; r < end; r += kTileRows) {
      const int64_t rows = std::min(kTileRows, end - r);
      for (size_t j = 0; j < blocks.size(); ++j) {
        for (size_t t = 0; t < targets.size(); ++t) {
          factor = factors[t * blocks.size() + j];
          kernels.subtract_product(blocks[j]->row(r), factor.data(), rows, targets[t]->row(r));
        }
      }
    }
  });
}

/// x <- x factor.
void multiply(TallBlock& x, const Small& factor) {
  const BlockKernels& kernels = kernels::block_kernels();
  for_chunks(x.rows(), [&](int64_t begin, int64_t end, int64_t) {
    // x - x (I - factor) would lose digits, so the product goes through a tile of zeros.
    alignas(64) double tile[kTileRows * kBlockWidth];
    alignas(64) const Small negated = -factor;
    for (int64_t r = begin; r < end; r += kTileRows) {
      const int64_t rows = std::min(kTileRows, end - r);
      std::fill_n(tile, rows * kBlockWidth, 0.0);
      kernels.subtract_product(x.row(r), negated.data(), rows, tile);
      std::copy_n(tile, rows * kBlockWidth, x.row(r));
    }
  });
}

/// target <- diag(factors) x; either may have more rows, which are left alone.
void scale_rows(const TallBlock& x, const Eigen::VectorXd& factors, TallBlock& target) {
  for_chunks(factors.size(), [&](int64_t begin, int64_t end, int64_t) {
    for (int64_t r = begin; r < end; ++r) {
      for (int64_t c = 0; c < kBlockWidth; ++c) target.row(r)[c] = factors[r] * x.row(r)[c];
    }
  });
}

/// The same numbers in (-1, 1) on every machine.
void fill_random(uint64_t seed, TallBlock& x) {
  for (int64_t i = 0; i < x.rows() * kBlockWidth; ++i) {
    const uint64_t bits = core::splitmix64(0, seed + static_cast<uint64_t>(i));
    x.data()[i] = std::ldexp(static_cast<double>(bits >> 11), -52) - 1.0;
  }
}

}  // namespace

BlockLanczos::BlockLanczos(const ShiftedFactor& factor, const Eigen::VectorXd& mass, double shift,
                           const Eigen::MatrixXd& known)
    : factor_(factor.ldlt()),
      shift_(shift),
      root_mass_(mass.size()),
      solved_(factor_.solve_rows()) {
  const Eigen::VectorXi& order = factor_.position();
  for (Eigen::Index i = 0; i < mass.size(); ++i) root_mass_[order[i]] = std::sqrt(mass[i]);
  for (Eigen::Index first = 0; first < known.cols(); first += kBlockWidth) {
    TallBlock& block = known_.emplace_back(mass.size());
    const Eigen::Index width = std::min<Eigen::Index>(kBlockWidth, known.cols() - first);
    for (Eigen::Index i = 0; i < mass.size(); ++i) {
      double* row = block.row(order[i]);
      for (Eigen::Index c = 0; c < width; ++c) {
        row[c] = root_mass_[order[i]] * known(i, first + c);
      }
    }
  }
}

std::vector<const TallBlock*> BlockLanczos::before(size_t count) const {
  Blocks blocks;
  for (const TallBlock& block : known_) blocks.push_back(&block);
  for (size_t j = 0; j < count; ++j) blocks.push_back(&basis_[j]);
  return blocks;
}

TallBlock BlockLanczos::apply(const TallBlock& x) {
  scale_rows(x, root_mass_, solved_);
  factor_.solve(solved_);
  TallBlock y(x.rows());
  scale_rows(solved_, root_mass_, y);
  return y;
}

void BlockLanczos::clear_of_basis(TallBlock& x) const {
  const Blocks blocks = before(basis_.size());
  if (!blocks.empty()) subtract(blocks, grams(blocks, {&x}), {&x});
}

/// x becomes orthonormal; the factor B with (x before) = (x after) B is returned.
Small BlockLanczos::orthonormalize(TallBlock& x) const {
  Small factor = Small::Identity();
  // Cholesky QR, twice: the second makes up for the rounding of the first.
  for (int pass = 0; pass < 2; ++pass) {
    const Eigen::LLT<Eigen::MatrixXd> cholesky(gram(x, x));
    constexpr double kDependent = 1e-6;  // Squared in the Gram matrix: still far from rounding.
    const Eigen::VectorXd pivots = cholesky.matrixLLT().diagonal();
    if (cholesky.info() != Eigen::Success ||
        !(pivots.minCoeff() > kDependent * pivots.maxCoeff())) {
      const Small rest = orthonormalize_columns(x);
      return rest * factor;
    }
    const Eigen::MatrixXd upper = cholesky.matrixU();
    const Eigen::MatrixXd inverse = upper.triangularView<Eigen::Upper>().solve(
        Eigen::MatrixXd::Identity(kBlockWidth, kBlockWidth));
    multiply(x, inverse);
    factor = (upper * factor).eval();
  }
  return factor;
}

/// As above where columns depend on each other: what vanishes is replaced by something new, with a
/// zero on the diagonal of B.
Small BlockLanczos::orthonormalize_columns(TallBlock& x) const {
  Eigen::Map<RowMajorMatrix> columns(x.data(), x.rows(), kBlockWidth);
  Small factor = Small::Zero();
  const double largest = columns.colwise().norm().maxCoeff();
  TallBlock fresh(x.rows());
  for (int64_t c = 0; c < kBlockWidth; ++c) {
    const auto clear = [&](bool record) {
      for (int64_t d = 0; d < c; ++d) {
        const double along = columns.col(d).dot(columns.col(c));
        columns.col(c) -= along * columns.col(d);
        if (record) factor(d, c) += along;
      }
    };
    clear(true);
    clear(true);
    const double norm = columns.col(c).norm();
    constexpr double kVanished = 1e-12;
    if (norm > kVanished * largest && norm > std::numeric_limits<double>::min()) {
      factor(c, c) = norm;
    } else {
      fill_random(static_cast<uint64_t>(dimension() + c + 2), fresh);
      clear_of_basis(fresh);
      clear_of_basis(fresh);
      columns.col(c) = Eigen::Map<const RowMajorMatrix>(fresh.data(), x.rows(), kBlockWidth).col(0);
      clear(false);
      clear(false);
    }
    columns.col(c).normalize();
  }
  return factor;
}

void BlockLanczos::start() {
  TallBlock x(root_mass_.size());
  fill_random(1, x);
  // Smoothed twice: what oscillates is most of a random vector and none of what is wanted.
  for (int pass = 0; pass < 2; ++pass) {
    x = apply(x);
    clear_of_basis(x);
    orthonormalize(x);
  }
  basis_.push_back(std::move(x));
}

void BlockLanczos::step() {
  const size_t j = diagonal_.size();
  TallBlock x = apply(basis_[j]);
  if (j > 0) subtract({&basis_[j - 1]}, {below_[j - 1].transpose()}, {&x});
  const Small along = gram(basis_[j], x);
  subtract({&basis_[j]}, {along}, {&x});
  if (++steps_since_clearing_ >= period_) clear_last_two(x);
  diagonal_.push_back(0.5 * (along + along.transpose()));
  below_.push_back(orthonormalize(x));
  basis_.push_back(std::move(x));
}

/// Clears the last block and x, which is to follow, of all blocks before. The recurrence needs
/// these two alone, so both are then as good as new. Between, each step multiplies what they have
/// of converged eigenvectors by up to theta_1 / |T_(j+1)j|: how much came up is measured, and the
/// next clearing set accordingly. T stays right to rounding while it is below 1e-8 (Simon 1984).
void BlockLanczos::clear_last_two(TallBlock& x) {
  TallBlock& last = basis_.back();
  const Blocks blocks = before(basis_.size() - 1);
  steps_since_clearing_ = 0;
  if (blocks.empty()) return;
  const std::vector<Small> factors = grams(blocks, {&last, &x});
  subtract(blocks, factors, {&last, &x});
  subtract({&last}, {gram(last, x)}, {&x});
  double lost = 0.0;
  for (size_t i = 0; i < blocks.size(); ++i) {
    lost = std::max(lost, factors[i].cwiseAbs().maxCoeff());
  }
  constexpr int kLongest = 4;
  if (lost > 1e-8) spoiled_ = true;
  if (lost > 1e-10) period_ = std::max(1, period_ - 1);
  if (lost < 1e-12) period_ = std::min(kLongest, period_ + 1);
}

void BlockLanczos::decompose() {
  const int64_t size = dimension();
  Eigen::MatrixXd projected = Eigen::MatrixXd::Zero(size, size);
  for (size_t j = 0; j < diagonal_.size(); ++j) {
    const int64_t at = kBlockWidth * static_cast<int64_t>(j);
    projected.block<kBlockWidth, kBlockWidth>(at, at) = diagonal_[j];
    if (j + 1 == diagonal_.size()) break;
    projected.block<kBlockWidth, kBlockWidth>(at + kBlockWidth, at) = below_[j];
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(projected);
  theta_ = solver.eigenvalues().reverse();
  ritz_ = solver.eigenvectors().rowwise().reverse();
}

double BlockLanczos::worst_residual(int64_t count, double floor) const {
  const Eigen::MatrixXd rest = below_.back() * ritz_.bottomLeftCorner(kBlockWidth, count).eval();
  double worst = 0.0;
  for (int64_t i = 0; i < count; ++i) {
    const double shifted = 1.0 / theta_[i];
    const double scale = std::max(shifted - shift_, floor);
    const double residual = theta_[i] > 0.0 ? rest.col(i).norm() * shifted * shifted / scale
                                            : std::numeric_limits<double>::infinity();
    worst = std::max(worst, residual);
  }
  return worst;
}

bool BlockLanczos::run(int64_t count, double tolerance, double floor, int64_t max_dimension,
                       const std::function<void(double)>& progress) {
  start();
  const int64_t expected = block_lanczos_dimension(count);
  int64_t next_look = std::min(expected, max_dimension);
  while (dimension() + kBlockWidth <= max_dimension) {
    step();
    if (spoiled_) return false;
    if (progress) {
      const double share = static_cast<double>(dimension()) / static_cast<double>(expected + 32);
      progress(std::min(1.0, share));
    }
    if (dimension() < std::min(next_look, max_dimension - kBlockWidth + 1)) continue;
    decompose();
    const double worst = worst_residual(count, floor);
    if (worst <= tolerance) return true;
    // Once it converges, residuals fall by about ten each 14 dimensions (measured on heads); a look
    // costs as much as two steps.
    const double digits = std::isfinite(worst) ? std::log10(worst / tolerance) : 4.0;
    next_look = dimension() + std::max(kBlockWidth, static_cast<int64_t>(14.0 * digits));
  }
  return false;
}

Eigen::VectorXd BlockLanczos::evals(int64_t count) const {
  return theta_.head(std::min<int64_t>(count, theta_.size())).cwiseInverse().array() - shift_;
}

Eigen::MatrixXd BlockLanczos::evecs(int64_t count) const {
  const int64_t rows = root_mass_.size();
  const int64_t num_groups = (count + kBlockWidth - 1) / kBlockWidth;
  const size_t num_blocks = basis_.size();  // the last is the next one: the power step
  Eigen::MatrixXd coefficients =
      Eigen::MatrixXd::Zero(dimension() + kBlockWidth, num_groups * kBlockWidth);
  coefficients.topLeftCorner(dimension(), count) = -ritz_.leftCols(count);
  coefficients.bottomLeftCorner(kBlockWidth, count) =
      -(below_.back() * ritz_.bottomLeftCorner(kBlockWidth, count).eval()) *
      theta_.head(count).cwiseInverse().asDiagonal();
  std::vector<Small> factors;
  for (int64_t g = 0; g < num_groups; ++g) {
    for (size_t j = 0; j < num_blocks; ++j) {
      factors.push_back(coefficients.block<kBlockWidth, kBlockWidth>(
          kBlockWidth * static_cast<int64_t>(j), kBlockWidth * g));
    }
  }
  Eigen::VectorXi vertex(rows);
  for (int64_t v = 0; v < rows; ++v) vertex[factor_.position()[v]] = static_cast<int>(v);
  Eigen::MatrixXd result(rows, count);
  const BlockKernels& kernels = kernels::block_kernels();
  for_chunks(rows, [&](int64_t begin, int64_t end, int64_t) {
    alignas(64) double tile[kTileRows * kBlockWidth];
    alignas(64) Small factor;
    for (int64_t r = begin; r < end; r += kTileRows) {
      const int64_t height = std::min(kTileRows, end - r);
      for (int64_t g = 0; g < num_groups; ++g) {
        std::fill_n(tile, height * kBlockWidth, 0.0);
        for (size_t j = 0; j < num_blocks; ++j) {
          factor = factors[static_cast<size_t>(g) * num_blocks + j];
          kernels.subtract_product(basis_[j].row(r), factor.data(), height, tile);
        }
        const int64_t width = std::min(kBlockWidth, count - g * kBlockWidth);
        for (int64_t i = 0; i < height; ++i) {
          for (int64_t c = 0; c < width; ++c) {
            result(vertex[r + i], g * kBlockWidth + c) =
                tile[i * kBlockWidth + c] / root_mass_[r + i];
          }
        }
      }
    }
  });
  return result;
}

int64_t block_lanczos_dimension(int64_t count) {
  // Of the form of Chebyshev's bound, with factors measured on heads for 16 to 256 pairs.
  const auto pairs = static_cast<double>(count);
  return static_cast<int64_t>(1.5 * pairs + 6.0 * std::sqrt(8.0 * pairs));
}

}  // namespace freetalk::geometry
