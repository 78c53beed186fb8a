#include "freetalk/geometry/eigenbasis.h"

#include <Eigen/Eigenvalues>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "block_lanczos.h"
#include "eigen_problem.h"
#include "freetalk/core/error.h"
#include "mesh/union_find.h"

namespace freetalk::geometry {
namespace {

/// A connected part: its vertices and its own problem.
struct Part {
  std::vector<int> vertices;  // ascending
  EigenProblem problem;
};

/// (V,) part of each vertex, numbered in order of first vertex: parts share no weight of L.
std::vector<int> part_labels(const SparseMatrix& laplacian) {
  mesh::UnionFind parts(static_cast<size_t>(laplacian.rows()));
  for (int column = 0; column < laplacian.outerSize(); ++column) {
    for (SparseMatrix::InnerIterator it(laplacian, column); it; ++it) {
      if (it.value() != 0.0) parts.join(static_cast<int>(it.row()), column);
    }
  }
  return parts.labels();
}

std::vector<Part> split(const SparseMatrix& laplacian, const Eigen::VectorXd& mass) {
  const std::vector<int> labels = part_labels(laplacian);
  std::vector<Part> parts(static_cast<size_t>(*std::max_element(labels.begin(), labels.end()) + 1));
  std::vector<int> index(labels.size());  // within the part
  for (size_t v = 0; v < labels.size(); ++v) {
    std::vector<int>& vertices = parts[static_cast<size_t>(labels[v])].vertices;
    index[v] = static_cast<int>(vertices.size());
    vertices.push_back(static_cast<int>(v));
  }
  for (Part& part : parts) {
    EigenProblem& problem = part.problem;
    if (parts.size() == 1) {
      problem.laplacian = laplacian;
      problem.mass = mass;
    } else {
      const auto size = static_cast<Eigen::Index>(part.vertices.size());
      problem.mass = mass(part.vertices);
      problem.laplacian.resize(size, size);
      for (Eigen::Index i = 0; i < size; ++i) {
        problem.laplacian.startVec(i);
        const int vertex = part.vertices[static_cast<size_t>(i)];
        for (SparseMatrix::InnerIterator it(laplacian, vertex); it; ++it) {
          if (labels[it.row()] != labels[vertex]) continue;  // a weight of zero
          problem.laplacian.insertBack(index[it.row()], i) = it.value();
        }
      }
      problem.laplacian.finalize();
    }
    problem.first_eval = 4.0 * std::numbers::pi / problem.mass.sum();
  }
  return parts;
}

/// (K,) see Eigenbasis::residuals.
Eigen::VectorXd residuals_of(const SparseMatrix& laplacian, const Eigen::VectorXd& mass,
                             const Eigenbasis& basis) {
  const Eigen::MatrixXd applied = laplacian * basis.evecs;
  const double first_eval = 4.0 * std::numbers::pi / mass.sum();
  // Weights of needle-like faces are huge, and so is their rounding: it is no fault of the
  // eigenpair.
  const double rounding = 1e-8 * laplacian.diagonal().maxCoeff();
  Eigen::VectorXd residuals(basis.evals.size());
  for (Eigen::Index i = 0; i < residuals.size(); ++i) {
    const Eigen::VectorXd weighted = mass.cwiseProduct(basis.evecs.col(i));
    const double scale = std::max(std::abs(basis.evals[i]), first_eval) * weighted.norm() +
                         rounding * basis.evecs.col(i).norm();
    residuals[i] = (applied.col(i) - basis.evals[i] * weighted).norm() / scale;
  }
  return residuals;
}

bool use_dense(const std::string& solver, int64_t size, int64_t count) {
  // Where the space Lanczos needs is not far from all there is, a full decomposition is faster.
  const int64_t needed =
      solver == "spectra" ? 2 * count + 2 : block_lanczos_dimension(count) + kBlockWidth;
  constexpr int64_t kSmall = 128;
  return solver == "dense" || size <= std::max(kSmall, 5 * needed / 4);
}

/// Solves one part with larger shifts and subspaces until the residuals are small enough.
Eigenbasis solve_part(const EigenProblem& problem, int64_t count, const EigenbasisOptions& options,
                      const std::string& name, const std::function<void(double)>& progress) {
  const auto with_residuals = [&](EigenPairs pairs) {
    Eigenbasis basis{std::move(pairs.evals), std::move(pairs.evecs), {}};
    basis.residuals = residuals_of(problem.laplacian, problem.mass, basis);
    return basis;
  };
  if (use_dense(options.solver, problem.mass.size(), count)) {
    return with_residuals(dense_eigenpairs(problem, count));
  }
  double worst = std::numeric_limits<double>::infinity();
  // A shift within the wanted eigenvalues, of which there are about `count` up to count first_eval,
  // costs few dimensions and keeps the largest theta near the others.
  const double shift = problem.first_eval * std::max(1.0, static_cast<double>(count) / 25.0);
  EigenRequest request{count, options.tolerance, shift, 1, name, progress};
  for (int attempt = 0; attempt < 3; ++attempt) {
    auto pairs = options.solver == "spectra" ? spectra_eigenpairs(problem, request)
                                             : block_eigenpairs(problem, request);
    if (pairs) {
      Eigenbasis basis = with_residuals(first_pairs(*std::move(pairs), count));
      worst = basis.residuals.maxCoeff();
      if (worst <= options.tolerance) return basis;
    }
    request.room *= 2;
    request.shift *= 10.0;
  }
  FREETALK_RUNTIME_CHECK(false, "the eigenbasis of ", name, " did not converge (", count,
                         " eigenpairs, largest residual ", worst,
                         "); use a smaller k_eig or repair the mesh");
  return {};
}

/// How many pairs of each part to compute first: its share of the area says how many there are
/// below a bound (Weyl's law), boundaries add to it.
std::vector<int64_t> first_counts(const std::vector<Part>& parts, double area, int64_t k) {
  std::vector<int64_t> counts;
  for (const Part& part : parts) {
    const auto size = static_cast<int64_t>(part.vertices.size());
    const double share = static_cast<double>(k) * part.problem.mass.sum() / area;
    const int64_t likely =
        parts.size() == 1 ? k : static_cast<int64_t>(1.1 * share + 2.0 * std::sqrt(share)) + 2;
    counts.push_back(std::min({likely, k, size}));
  }
  return counts;
}

/// A pair of one part.
struct PairOfPart {
  double eval;
  size_t part;
  int64_t index;
};

std::vector<PairOfPart> smallest(const std::vector<Eigenbasis>& bases, int64_t k) {
  std::vector<PairOfPart> all;
  for (size_t p = 0; p < bases.size(); ++p) {
    for (Eigen::Index i = 0; i < bases[p].evals.size(); ++i) {
      all.push_back({bases[p].evals[i], p, i});
    }
  }
  std::stable_sort(all.begin(), all.end(),
                   [](const PairOfPart& a, const PairOfPart& b) { return a.eval < b.eval; });
  all.resize(std::min(all.size(), static_cast<size_t>(k)));
  return all;
}

/// Passes the progress of a part on as that of the whole.
class PartProgress {
 public:
  PartProgress(const std::function<void(double)>& progress, double total)
      : progress_(progress), total_(total) {}

  std::function<void(double)> of_part(int64_t size) const {
    if (!progress_) return {};
    return [this, size](double share) {
      progress_(std::min(1.0, (done_ + share * static_cast<double>(size)) / total_));
    };
  }
  void finish(int64_t size) { done_ += static_cast<double>(size); }

 private:
  const std::function<void(double)>& progress_;
  double total_;
  double done_ = 0.0;
};

}  // namespace

void EigenbasisOptions::check() const {
  FREETALK_CHECK(k >= 1, "k must be at least 1, found ", k);
  FREETALK_CHECK(tolerance > 0.0, "tolerance must be positive, found ", tolerance);
  FREETALK_CHECK(solver == "auto" || solver == "block" || solver == "spectra" || solver == "dense",
                 "solver must be \"auto\", \"block\", \"spectra\" or \"dense\", found \"", solver,
                 "\"");
}

Eigenbasis eigenbasis(const SparseMatrix& laplacian, const Eigen::VectorXd& mass,
                      const EigenbasisOptions& options, const std::string& name,
                      const std::function<void(double)>& progress) {
  options.check();
  const Eigen::Index size = mass.size();
  FREETALK_CHECK(laplacian.rows() == size && laplacian.cols() == size, "eigenbasis of ", name,
                 " needs a Laplacian of shape (", size, ", ", size, ") as the mass has ", size,
                 " entries, found (", laplacian.rows(), ", ", laplacian.cols(), ")");
  const int64_t k = options.k;
  FREETALK_CHECK(k <= size, "eigenbasis of ", name, " was asked for ", k,
                 " eigenpairs but the mesh has ", size, " vertices; use k_eig <= ", size);
  const double area = mass.sum();
  FREETALK_CHECK(std::isfinite(area) && mass.minCoeff() > 0.0, "eigenbasis of ", name,
                 " needs a positive mass at every vertex; the surface has no area");
  SparseMatrix identity(size, size);
  identity.setIdentity();
  const SparseMatrix regularized = laplacian + 1e-8 * identity;
  FREETALK_CHECK(regularized.coeffs().allFinite(), "eigenbasis of ", name,
                 " needs a finite Laplacian; the mesh has NaN, huge or tiny coordinates");
  const std::vector<Part> parts = split(regularized, mass);

  std::vector<Eigenbasis> bases(parts.size());
  std::vector<int64_t> counts = first_counts(parts, area, k);
  PartProgress part_progress(progress, static_cast<double>(size));
  std::vector<PairOfPart> chosen;
  for (bool complete = false; !complete;) {
    for (size_t p = 0; p < parts.size(); ++p) {
      if (bases[p].evals.size() == counts[p]) continue;
      const auto part_size = static_cast<int64_t>(parts[p].vertices.size());
      bases[p] =
          solve_part(parts[p].problem, counts[p], options, name, part_progress.of_part(part_size));
      part_progress.finish(part_size);
    }
    chosen = smallest(bases, k);
    // A part all of whose pairs were chosen may have more below the last one chosen.
    complete = true;
    const bool enough = chosen.size() == static_cast<size_t>(k);
    for (size_t p = 0; p < parts.size(); ++p) {
      const int64_t most = std::min<int64_t>(k, static_cast<int64_t>(parts[p].vertices.size()));
      if (counts[p] == most) continue;
      if (enough && bases[p].evals[counts[p] - 1] >= chosen.back().eval) continue;
      counts[p] = std::min(2 * counts[p], most);
      complete = false;
    }
  }
  if (parts.size() == 1) {
    bases[0].evals = bases[0].evals.cwiseMax(0.0);
    if (progress) progress(1.0);
    return std::move(bases[0]);
  }
  Eigenbasis basis{Eigen::VectorXd(k), Eigen::MatrixXd::Zero(size, k), {}};
  for (int64_t i = 0; i < k; ++i) {
    const PairOfPart& from = chosen[static_cast<size_t>(i)];
    basis.evals[i] = from.eval;
    basis.evecs.col(i)(parts[from.part].vertices) = bases[from.part].evecs.col(from.index);
  }
  basis.residuals = residuals_of(regularized, mass, basis);
  basis.evals = basis.evals.cwiseMax(0.0);
  if (progress) progress(1.0);
  return basis;
}

}  // namespace freetalk::geometry
