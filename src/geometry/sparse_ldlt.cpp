#include "sparse_ldlt.h"

#include <algorithm>

#include "core/parallel.h"
#include "kernels/ldlt_kernels.h"

namespace freetalk::geometry {
namespace {

using kernels::Front;
using kernels::kBlockWidth;
using kernels::LdltKernels;
using kernels::TallBlock;

constexpr int64_t kPanelRows = 32;          // eliminated between two updates of what is left
constexpr int64_t kTaskRows = 64;           // of an update that is shared
constexpr int64_t kSharedUpdate = 1 << 21;  // multiplications from which threads share an update
constexpr int64_t kSharedSolve = 1 << 16;   // entries of a panel from which threads share a solve

/// For each subtree and then, where those are done, the supernodes above.
template <class Body>
void for_subtrees(const EliminationTree& tree, const Body& body) {
  const auto count = static_cast<int64_t>(tree.subtrees.size());
  core::parallel_tasks(count, core::num_threads(), body);
}

}  // namespace

/// Of a thread.
struct SparseLdlt::Work {
  std::vector<int> local;  // row of the front that has this row of L
  std::vector<int> place;  // of a child's rows in the front
  TallBlock front{0};
};

SparseLdlt::SparseLdlt(const SparseMatrix& matrix)
    : tree_(matrix),
      panels_(static_cast<size_t>(tree_.num_values)),
      updates_(tree_.nodes.size()),
      pivots_(matrix.rows()),
      inverse_pivots_(matrix.rows()) {
  place_rows();
}

/// Within a subtree, rows above it are rows that no other subtree touches.
void SparseLdlt::place_rows() {
  solve_row_ = tree_.rows;
  solve_rows_ = size();
  for (const int root : tree_.subtrees) {
    const Supernode& last = tree_.nodes[static_cast<size_t>(root)];
    const auto above = tree_.rows.begin() + last.rows;
    const int end = last.first + last.width;
    subtree_rows_.push_back(solve_rows_);
    for (int node = last.begin; node <= root; ++node) {
      const Supernode& below = tree_.nodes[static_cast<size_t>(node)];
      auto at = above;
      for (int64_t i = below.rows; i < below.rows + below.num_rows; ++i) {
        const int row = tree_.rows[static_cast<size_t>(i)];
        if (row < end) continue;
        at = std::lower_bound(at, above + last.num_rows, row);
        solve_row_[static_cast<size_t>(i)] = static_cast<int>(solve_rows_ + (at - above));
      }
    }
    solve_rows_ += last.num_rows;
  }
}

/// The matrix's own entries and the children's updates.
void SparseLdlt::assemble(int index, const SparseMatrix& matrix, Work& work) {
  const Supernode& node = tree_.nodes[static_cast<size_t>(index)];
  const int64_t size = node.size(), stride = kernels::front_stride(size);
  if (work.front.rows() * kBlockWidth < size * stride) {
    work.front = TallBlock(size * stride / kBlockWidth);
  }
  double* front = work.front.data();
  std::fill_n(front, size * stride, 0.0);
  for (int c = 0; c < node.width; ++c) work.local[node.first + c] = c;
  for (int64_t i = 0; i < node.num_rows; ++i) {
    work.local[tree_.rows[static_cast<size_t>(node.rows + i)]] = static_cast<int>(node.width + i);
  }
  for (int c = 0; c < node.width; ++c) {
    const int column = node.first + c;
    for (SparseMatrix::InnerIterator it(matrix, tree_.order[column]); it; ++it) {
      const int row = tree_.position[it.row()];
      if (row >= column) front[c * stride + work.local[row]] += it.value();
    }
  }
  for (const int child : tree_.children[static_cast<size_t>(index)]) {
    const Supernode& below = tree_.nodes[static_cast<size_t>(child)];
    work.place.clear();
    for (int64_t i = below.rows; i < below.rows + below.num_rows; ++i) {
      work.place.push_back(work.local[tree_.rows[static_cast<size_t>(i)]]);
    }
    std::vector<double>& update = updates_[static_cast<size_t>(child)];
    const double* value = update.data();
    for (size_t i = 0; i < work.place.size(); ++i) {
      double* target = front + work.place[i] * stride;
      for (size_t j = i; j < work.place.size(); ++j) target[work.place[j]] += *value++;
    }
    update = {};
  }
}

void SparseLdlt::eliminate(int index, const SparseMatrix& matrix, Work& work) {
  assemble(index, matrix, work);
  const LdltKernels& kernels = kernels::ldlt_kernels();
  const Supernode& node = tree_.nodes[static_cast<size_t>(index)];
  const int64_t size = node.size();
  const Front front{work.front.data(), kernels::front_stride(size), size};
  double* panel = panels_.data() + node.panel;
  for (int64_t first = 0; first < node.width; first += kPanelRows) {
    const int64_t last = std::min<int64_t>(first + kPanelRows, node.width), left = size - last;
    kernels.eliminate(front, first, last, panel, pivots_.data() + node.first);
    // Pieces are cut by rows alone, so that bits do not depend on threads.
    const int64_t pieces = (left + kTaskRows - 1) / kTaskRows;
    const bool shared = left * left * (last - first) >= kSharedUpdate;
    core::parallel_tasks(pieces, shared ? pieces : 1, [&](int64_t piece, int64_t) {
      const int64_t begin = last + piece * kTaskRows;
      kernels.update(front, first, last, begin, std::min(begin + kTaskRows, size), panel);
    });
  }
  std::vector<double>& update = updates_[static_cast<size_t>(index)];
  update.resize(static_cast<size_t>(node.num_rows * (node.num_rows + 1) / 2));
  double* value = update.data();
  for (int64_t i = node.width; i < size; ++i) {
    value = std::copy_n(front.data + i * front.stride + i, size - i, value);
  }
}

bool SparseLdlt::factorize(const SparseMatrix& matrix) {
  std::vector<Work> work(static_cast<size_t>(core::num_threads()));
  for_subtrees(tree_, [&](int64_t task, int64_t worker) {
    Work& own = work[static_cast<size_t>(worker)];
    own.local.resize(tree_.order.size());
    const int root = tree_.subtrees[static_cast<size_t>(task)];
    for (int node = tree_.nodes[static_cast<size_t>(root)].begin; node <= root; ++node) {
      eliminate(node, matrix, own);
    }
  });
  work[0].local.resize(tree_.order.size());
  for (const int node : tree_.top) eliminate(node, matrix, work[0]);
  inverse_pivots_ = pivots_.cwiseInverse();
  return inverse_pivots_.allFinite() && pivots_.allFinite();
}

void SparseLdlt::solve_lower(int index, double* x) const {
  const LdltKernels& kernels = kernels::ldlt_kernels();
  const Supernode& node = tree_.nodes[static_cast<size_t>(index)];
  const double* panel = panels_.data() + node.panel;
  double* own = x + node.first * kBlockWidth;
  kernels.solve_lower(panel, node.size(), node.width, own);
  const int* row = solve_row_.data() + node.rows;
  const bool shared = node.size() * node.width >= kSharedSolve;
  core::parallel_for(0, node.num_rows, shared ? kTaskRows : node.num_rows,
                     [&](int64_t begin, int64_t end) {
                       kernels.scatter(panel, node.size(), node.width, own, row, begin, end, x);
                     });
}

void SparseLdlt::solve_upper(int index, double* x) const {
  const LdltKernels& kernels = kernels::ldlt_kernels();
  const Supernode& node = tree_.nodes[static_cast<size_t>(index)];
  const double* panel = panels_.data() + node.panel;
  double* own = x + node.first * kBlockWidth;
  for (int p = 0; p < node.width; ++p) {
    for (int64_t c = 0; c < kBlockWidth; ++c) {
      own[p * kBlockWidth + c] *= inverse_pivots_[node.first + p];
    }
  }
  const int* row = solve_row_.data() + node.rows;
  const int64_t blocks = (node.width + kBlockWidth - 1) / kBlockWidth;
  const bool shared = node.size() * node.width >= kSharedSolve;
  core::parallel_for(0, blocks, shared ? 1 : blocks, [&](int64_t begin, int64_t end) {
    kernels.gather(panel, node.size(), node.width, begin * kBlockWidth,
                   std::min<int64_t>(end * kBlockWidth, node.width), row, x, own);
  });
  kernels.solve_upper(panel, node.size(), node.width, own);
}

void SparseLdlt::solve(TallBlock& x) const {
  double* data = x.data();
  std::fill(x.row(size()), x.row(solve_rows_), 0.0);
  for_subtrees(tree_, [&](int64_t task, int64_t) {
    const int root = tree_.subtrees[static_cast<size_t>(task)];
    for (int node = tree_.nodes[static_cast<size_t>(root)].begin; node <= root; ++node) {
      solve_lower(node, data);
    }
  });
  const auto own_rows = [&](size_t task,
                            const auto& body) {  // body(row of L, row of the subtree's)
    const Supernode& root = tree_.nodes[static_cast<size_t>(tree_.subtrees[task])];
    for (int64_t i = 0; i < root.num_rows; ++i) {
      body(x.row(tree_.rows[static_cast<size_t>(root.rows + i)]), x.row(subtree_rows_[task] + i));
    }
  };
  for (size_t task = 0; task < tree_.subtrees.size(); ++task) {
    own_rows(task, [](double* row, const double* own) {
      for (int64_t c = 0; c < kBlockWidth; ++c) row[c] += own[c];
    });
  }
  for (const int node : tree_.top) solve_lower(node, data);
  for (auto node = tree_.top.rbegin(); node != tree_.top.rend(); ++node) solve_upper(*node, data);
  for_subtrees(tree_, [&](int64_t task, int64_t) {
    own_rows(static_cast<size_t>(task),
             [](const double* row, double* own) { std::copy_n(row, kBlockWidth, own); });
    const int root = tree_.subtrees[static_cast<size_t>(task)];
    for (int node = root; node >= tree_.nodes[static_cast<size_t>(root)].begin; --node) {
      solve_upper(node, data);
    }
  });
}

}  // namespace freetalk::geometry
