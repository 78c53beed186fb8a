#include "elimination_tree.h"

#include <Eigen/OrderingMethods>

#include <algorithm>
#include <numeric>
#include <queue>
#include <utility>

namespace freetalk::geometry {
namespace {

constexpr int kWidest = 256;  // columns of a supernode: wider ones become chains

/// Liu's algorithm: parent[j] is the first row below the diagonal of column j of L.
std::vector<int> column_tree(const SparseMatrix& matrix, const std::vector<int>& order,
                             const Eigen::VectorXi& position) {
  const auto size = static_cast<int>(order.size());
  std::vector<int> parent(order.size(), -1), ancestor(order.size(), -1);
  for (int column = 0; column < size; ++column) {
    for (SparseMatrix::InnerIterator it(matrix, order[column]); it; ++it) {
      int at = position[it.row()];
      while (at != -1 && at < column) {
        const int next = std::exchange(ancestor[at], column);
        if (next == -1) parent[at] = column;
        at = next;
      }
    }
  }
  return parent;
}

/// Entries of each column of L with its diagonal: row `row` of L has those on the tree's paths from
/// the entries of the matrix's row up to `row`.
std::vector<int> column_counts(const SparseMatrix& matrix, const std::vector<int>& order,
                               const Eigen::VectorXi& position, const std::vector<int>& parent) {
  const auto size = static_cast<int>(order.size());
  std::vector<int> count(order.size(), 1), mark(order.size(), -1);
  for (int row = 0; row < size; ++row) {
    mark[row] = row;
    for (SparseMatrix::InnerIterator it(matrix, order[row]); it; ++it) {
      for (int at = position[it.row()]; at < row && mark[at] != row; at = parent[at]) {
        mark[at] = row;
        ++count[at];
      }
    }
  }
  return count;
}

/// Children before parents, subtrees in one piece; the child with the longest column comes last,
/// next to its parent, with which it is most likely to share a supernode.
std::vector<int> postorder(const std::vector<int>& parent, const std::vector<int>& count) {
  const auto size = static_cast<int>(parent.size());
  std::vector<int> head(parent.size() + 1, -1), next(parent.size(), -1), by_count(parent.size());
  std::iota(by_count.begin(), by_count.end(), 0);
  std::stable_sort(by_count.begin(), by_count.end(),
                   [&](int a, int b) { return count[a] > count[b]; });
  for (const int node : by_count) {  // pushed to the front: ascending lists
    int& list = head[static_cast<size_t>(parent[node] < 0 ? size : parent[node])];
    next[node] = std::exchange(list, node);
  }
  std::vector<int> result, stack;
  result.reserve(parent.size());
  for (int root = head[parent.size()]; root != -1; root = next[root]) {
    stack.push_back(root);
    while (!stack.empty()) {
      int& child = head[static_cast<size_t>(stack.back())];
      if (child != -1) {
        stack.push_back(std::exchange(child, next[child]));
      } else {
        result.push_back(stack.back());
        stack.pop_back();
      }
    }
  }
  return result;
}

/// Whether it pays to store so large a share of zeros in a supernode of this width.
bool worth_merging(int64_t width, int64_t zeros, int64_t stored) {
  if (zeros == 0) return width <= kWidest;
  const double share = static_cast<double>(zeros) / static_cast<double>(stored);
  return width <= 4    ? share < 0.6
         : width <= 16 ? share < 0.3
         : width <= 48 ? share < 0.1
                       : width <= kWidest && share < 0.05;
}

}  // namespace

EliminationTree::EliminationTree(const SparseMatrix& matrix) {
  std::vector<int> parent, count;
  order_columns(matrix, parent, count);
  find_supernodes(parent, count);
  find_rows(matrix);
  cut();
}

void EliminationTree::order_columns(const SparseMatrix& matrix, std::vector<int>& parent,
                                    std::vector<int>& count) {
  Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> minimum_degree;
  Eigen::AMDOrdering<int>()(matrix.selfadjointView<Eigen::Lower>(), minimum_degree);
  const auto& indices = minimum_degree.indices();
  order.assign(indices.data(), indices.data() + indices.size());
  position.resize(indices.size());
  const auto place = [&] {
    for (size_t j = 0; j < order.size(); ++j) position[order[j]] = static_cast<int>(j);
  };
  place();
  const std::vector<int> first_parent = column_tree(matrix, order, position);
  const std::vector<int> first_count = column_counts(matrix, order, position, first_parent);
  const std::vector<int> sequence = postorder(first_parent, first_count);
  std::vector<int> rank(sequence.size()), ordered(sequence.size());
  for (size_t j = 0; j < sequence.size(); ++j) {
    rank[sequence[j]] = static_cast<int>(j);
    ordered[j] = order[sequence[j]];
  }
  order = std::move(ordered);
  place();
  parent.resize(sequence.size());
  count.resize(sequence.size());
  for (size_t j = 0; j < sequence.size(); ++j) {
    const int before = first_parent[sequence[j]];
    parent[j] = before < 0 ? -1 : rank[before];
    count[j] = first_count[sequence[j]];
  }
}

void EliminationTree::find_supernodes(const std::vector<int>& parent,
                                      const std::vector<int>& count) {
  struct Run {
    int first, width;
    int64_t size, entries;  // rows with the triangle's, entries of L
  };
  std::vector<Run> runs;
  // Equal columns first, then runs that differ in few zeros; a run may join its last child.
  const auto join = [&](Run run, bool with_zeros) {
    while (!runs.empty()) {
      const Run& child = runs.back();
      if (parent[run.first - 1] != run.first) break;  // not the parent of the run before
      const int64_t width = child.width + run.width, size = child.width + run.size;
      const int64_t stored = width * size - width * (width - 1) / 2;
      const int64_t zeros = stored - child.entries - run.entries;
      if ((zeros > 0 && !with_zeros) || !worth_merging(width, zeros, stored)) break;
      run = {child.first, static_cast<int>(width), size, child.entries + run.entries};
      runs.pop_back();
    }
    runs.push_back(run);
  };
  for (size_t j = 0; j < parent.size(); ++j)
    join({static_cast<int>(j), 1, count[j], count[j]}, false);
  const std::vector<Run> equal = std::exchange(runs, {});
  for (const Run& run : equal) join(run, true);
  nodes.reserve(runs.size());
  for (const Run& run : runs) {
    nodes.push_back({run.first, run.width, 0, run.size - run.width, num_values, -1, 0});
    num_values += nodes.back().size() * run.width;
  }
}

void EliminationTree::find_rows(const SparseMatrix& matrix) {
  std::vector<int> node_of(order.size()), mark(order.size(), -1);
  for (size_t s = 0; s < nodes.size(); ++s) {
    std::fill_n(node_of.begin() + nodes[s].first, nodes[s].width, static_cast<int>(s));
  }
  children.resize(nodes.size());
  for (size_t s = 0; s < nodes.size(); ++s) {
    Supernode& node = nodes[s];
    const int end = node.first + node.width;
    node.rows = static_cast<int64_t>(rows.size());
    node.begin = static_cast<int>(s);
    const auto add = [&](int row) {
      if (row < end || mark[row] == static_cast<int>(s)) return;
      mark[row] = static_cast<int>(s);
      rows.push_back(row);
    };
    for (int column = node.first; column < end; ++column) {
      for (SparseMatrix::InnerIterator it(matrix, order[column]); it; ++it) add(position[it.row()]);
    }
    for (const int child : children[s]) {
      const Supernode& below = nodes[static_cast<size_t>(child)];
      node.begin = std::min(node.begin, below.begin);
      for (int64_t i = 0; i < below.num_rows; ++i) add(rows[static_cast<size_t>(below.rows + i)]);
    }
    node.num_rows = static_cast<int64_t>(rows.size()) - node.rows;
    std::sort(rows.begin() + node.rows, rows.end());
    if (node.num_rows == 0) continue;
    node.parent = node_of[rows[static_cast<size_t>(node.rows)]];
    children[static_cast<size_t>(node.parent)].push_back(static_cast<int>(s));
  }
}

void EliminationTree::cut() {
  // Elimination and solves both count: a product costs less in a large front.
  std::vector<double> work(nodes.size(), 0.0);
  double total = 0.0;
  for (size_t s = 0; s < nodes.size(); ++s) {
    const auto width = static_cast<double>(nodes[s].width);
    const auto size = static_cast<double>(nodes[s].size());
    const double own = width * size * (size + 100.0) + 1000.0;
    total += own;
    work[s] += own;
    if (nodes[s].parent >= 0) work[static_cast<size_t>(nodes[s].parent)] += work[s];
  }
  const auto cheaper = [&](int a, int b) {
    return std::pair(work[static_cast<size_t>(a)], a) < std::pair(work[static_cast<size_t>(b)], b);
  };
  std::priority_queue<int, std::vector<int>, decltype(cheaper)> queue(cheaper);
  for (size_t s = 0; s < nodes.size(); ++s) {
    if (nodes[s].parent < 0) queue.push(static_cast<int>(s));
  }
  constexpr double kShare = 1.0 / 24.0, kLeast = 4e6;  // below, threads cost more than they give
  const double most = std::max(kShare * total, kLeast);
  while (!queue.empty()) {
    const int node = queue.top();
    queue.pop();
    if (work[static_cast<size_t>(node)] <= most) {
      subtrees.push_back(node);
      continue;
    }
    top.push_back(node);
    for (const int child : children[static_cast<size_t>(node)]) queue.push(child);
  }
  std::sort(top.begin(), top.end());
}

}  // namespace freetalk::geometry
