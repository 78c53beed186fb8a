// Disjoint sets of 0 .. N - 1, joined one pair at a time.
#pragma once

#include <algorithm>
#include <numeric>
#include <vector>

namespace freetalk::mesh {

class UnionFind {
 public:
  explicit UnionFind(size_t count) : parent_(count) {
    std::iota(parent_.begin(), parent_.end(), 0);
  }

  /// The smallest member of i's set.
  int root(int i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }

  void join(int a, int b) {
    a = root(a);
    b = root(b);
    parent_[std::max(a, b)] = std::min(a, b);
  }

  /// (N,) the set of each, numbered in the order of their smallest members.
  std::vector<int> labels() {
    std::vector<int> labels(parent_.size());
    int count = 0;
    for (int i = 0; i < static_cast<int>(parent_.size()); ++i) {
      const int r = root(i);  // r <= i: its label is set.
      labels[i] = r == i ? count++ : labels[r];
    }
    return labels;
  }

 private:
  std::vector<int> parent_;
};

}  // namespace freetalk::mesh
