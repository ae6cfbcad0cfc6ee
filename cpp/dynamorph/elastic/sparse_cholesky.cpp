// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/elastic/sparse_cholesky.hpp"

#include <Eigen/OrderingMethods>
#include <algorithm>
#include <type_traits>

#include "dynamorph/elastic/sparse_kernels.hpp"

namespace dynamorph {

// --- Structure -------------------------------------------------------------------------------------------------------

/// Rows and columns are those of 3x3 blocks, in elimination order, unless they are called scalar.
struct SymbolicCholesky {
  struct Supernode {
    int first, columns;  ///< it eliminates first .. first + columns - 1
    int rows;            ///< its columns and the rows below that they fill
    size_t below;        ///< where the rows below begin in `rows_below` and `in_parent`
    size_t factor;       ///< where its panel begins in the factor: (3 rows, 3 columns) scalars, column-major
    size_t update;       ///< where its update matrix begins in the work space
    size_t entries;      ///< where its part of A begins in `entries`
    std::vector<int> children;
  };
  struct Entry {
    int value;        ///< index among A's values
    int row, column;  ///< scalar, in the supernode's panel
  };

  explicit SymbolicCholesky(const SparseMatrix& A);
  bool has_pattern_of(const SparseMatrix& A) const;

  std::vector<int> order;             ///< the node that is eliminated k-th
  std::vector<Supernode> supernodes;  ///< children before parents
  std::vector<int> rows_below;        ///< ascending for each supernode
  std::vector<int> in_parent;         ///< their places among the parent's rows
  std::vector<Entry> entries;
  int most_rows = 0;
  size_t factor_size = 0, updates_size = 0;
  double work = 0;  ///< multiplications per factorization

 private:
  using Structure = std::vector<std::vector<int>>;
  Structure eliminate(const Structure& neighbors);
  void gather_supernodes(const Structure& below);
  int local_row(const Supernode& s, int row) const;
  std::vector<int> link_supernodes();
  void place_entries(const SparseMatrix& A);
  void place_updates(const std::vector<int>& parents);

  std::vector<int> outer_, inner_;  ///< the pattern of A
};

namespace {

constexpr int kDepth = 48;  // scalar columns eliminated between two updates of the rest; four strips stay in the cache

/// Number of scalar rows, padded so that a tile can begin at the last of them.
int padded(int scalars) { return (scalars + kStrip + 3) / 4 * 4; }

/// The nodes that share a block with each node, ascending and without the node itself.
std::vector<std::vector<int>> neighbors_of(const SparseMatrix& A) {
  std::vector<std::vector<int>> neighbors(A.cols() / 3);
  for (int c = 0; c < A.outerSize(); ++c)
    for (SparseMatrix::InnerIterator it(A, c); it; ++it)
      if (it.row() / 3 != c / 3) neighbors[c / 3].push_back(int(it.row()) / 3);
  for (std::vector<int>& list : neighbors) {
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
  }
  return neighbors;
}

std::vector<int> minimum_degree(const std::vector<std::vector<int>>& neighbors) {
  const int n = int(neighbors.size());
  std::vector<Eigen::Triplet<double>> entries;
  for (int j = 0; j < n; ++j) {
    entries.emplace_back(j, j, 1.0);
    for (int i : neighbors[j]) entries.emplace_back(i, j, 1.0);
  }
  SparseMatrix graph(n, n);
  graph.setFromTriplets(entries.begin(), entries.end());
  Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> permutation;
  Eigen::AMDOrdering<int>()(graph, permutation);
  return {permutation.indices().data(), permutation.indices().data() + n};
}

std::vector<int> inverse(const std::vector<int>& order) {
  std::vector<int> position(order.size());
  for (size_t k = 0; k < order.size(); ++k) position[order[k]] = int(k);
  return position;
}

/// The columns in postorder of the elimination tree. Every subtree is one run, and its largest child comes last.
std::vector<int> postorder(const std::vector<std::vector<int>>& below) {
  const int n = int(below.size());
  std::vector<std::vector<int>> children(n + 1);
  for (int j = 0; j < n; ++j) children[below[j].empty() ? n : below[j][0]].push_back(j);
  for (std::vector<int>& list : children)
    std::stable_sort(list.begin(), list.end(), [&](int a, int b) { return below[a].size() > below[b].size(); });
  std::vector<int> reversed, open = {n};  // parents first, and their largest child next
  while (!open.empty()) {
    const int j = open.back();
    open.pop_back();
    reversed.push_back(j);
    open.insert(open.end(), children[j].rbegin(), children[j].rend());
  }
  return {reversed.rbegin(), reversed.rend() - 1};
}

/// Whether to eliminate a child together with its parent, although `zeros` of the `size` blocks stored are then zero.
bool worth_merging(int columns, double zeros, double size) {
  return columns <= 2 || zeros < (columns <= 6 ? 0.5 : columns <= 16 ? 0.15 : 0.05) * size;
}

/// Columns that are eliminated together.
struct Group {
  int first, columns, rows;
  double zeros;
  double size() const { return columns * (rows - 0.5 * (columns - 1)); }  ///< blocks of the lower triangle
};

/// Groups runs of columns with the same rows below. A child and its parent are merged if their rows are nearly the
/// same.
std::vector<Group> group_columns(const std::vector<std::vector<int>>& below) {
  std::vector<Group> groups, merged;
  for (int j = 0; j < int(below.size()); ++j) {
    const int rows = int(below[j].size());
    if (j > 0 && !below[j - 1].empty() && below[j - 1][0] == j && int(below[j - 1].size()) == rows + 1)
      ++groups.back().columns;
    else
      groups.push_back({j, 1, rows + 1, 0});
  }
  for (Group group : groups) {
    for (; !merged.empty(); merged.pop_back()) {
      const Group& child = merged.back();
      const std::vector<int>& rows = below[group.first - 1];
      if (rows.empty() || rows[0] >= group.first + group.columns) break;
      Group both{child.first, child.columns + group.columns, child.columns + group.rows, 0};
      both.zeros = child.zeros + group.zeros + both.size() - child.size() - group.size();
      if (!worth_merging(both.columns, both.zeros, both.size())) break;
      group = both;
    }
    merged.push_back(group);
  }
  return merged;
}

}  // namespace

SymbolicCholesky::SymbolicCholesky(const SparseMatrix& A)
    : outer_(A.outerIndexPtr(), A.outerIndexPtr() + A.cols() + 1),
      inner_(A.innerIndexPtr(), A.innerIndexPtr() + A.nonZeros()) {
  const Structure neighbors = neighbors_of(A);
  order = minimum_degree(neighbors);
  gather_supernodes(eliminate(neighbors));
  place_updates(link_supernodes());
  place_entries(A);
}

bool SymbolicCholesky::has_pattern_of(const SparseMatrix& A) const {
  return outer_.size() == size_t(A.cols() + 1) && inner_.size() == size_t(A.nonZeros()) &&
         std::equal(outer_.begin(), outer_.end(), A.outerIndexPtr()) &&
         std::equal(inner_.begin(), inner_.end(), A.innerIndexPtr());
}

/// Returns the rows below the diagonal of each of the factor's columns, and puts `order` in postorder.
SymbolicCholesky::Structure SymbolicCholesky::eliminate(const Structure& neighbors) {
  const int n = int(neighbors.size());
  const std::vector<int> position = inverse(order);
  Structure below(n);
  for (int j = 0; j < n; ++j) {
    std::vector<int>& rows = below[j];  // already holds the children's rows
    for (int i : neighbors[order[j]])
      if (position[i] > j) rows.push_back(position[i]);
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
    if (!rows.empty()) below[rows[0]].insert(below[rows[0]].end(), rows.begin() + 1, rows.end());
  }
  const std::vector<int> after = postorder(below), place = inverse(after);
  Structure out(n);
  std::vector<int> reordered(n);
  for (int k = 0; k < n; ++k) {
    reordered[k] = order[after[k]];
    for (int i : below[after[k]]) out[k].push_back(place[i]);
    std::sort(out[k].begin(), out[k].end());
  }
  order = reordered;
  return out;
}

void SymbolicCholesky::gather_supernodes(const Structure& below) {
  for (const Group& group : group_columns(below)) {
    supernodes.push_back({group.first, group.columns, group.rows, rows_below.size(), factor_size, 0, 0, {}});
    const std::vector<int>& rows = below[group.first + group.columns - 1];
    rows_below.insert(rows_below.end(), rows.begin(), rows.end());
    factor_size += size_t(9) * group.rows * group.columns;
    most_rows = std::max(most_rows, group.rows);
    for (int k = 0; k < group.columns; ++k) work += 27 * 0.5 * (group.rows - k) * (group.rows - k);
  }
}

/// The place of a row among a supernode's own rows.
int SymbolicCholesky::local_row(const Supernode& s, int row) const {
  if (row < s.first + s.columns) return row - s.first;
  const auto first = rows_below.begin() + s.below, last = first + (s.rows - s.columns);
  return s.columns + int(std::lower_bound(first, last, row) - first);
}

/// Finds the children and the places of their rows among their parents' rows. Returns the parents, -1 for roots.
std::vector<int> SymbolicCholesky::link_supernodes() {
  std::vector<int> supernode_of(order.size()), parents(supernodes.size(), -1);
  for (size_t k = 0; k < supernodes.size(); ++k)
    std::fill_n(supernode_of.begin() + supernodes[k].first, supernodes[k].columns, int(k));
  for (size_t k = 0; k < supernodes.size(); ++k) {
    const Supernode& s = supernodes[k];
    if (s.rows == s.columns) continue;
    parents[k] = supernode_of[rows_below[s.below]];
    supernodes[parents[k]].children.push_back(int(k));
    for (int i = 0; i < s.rows - s.columns; ++i)
      in_parent.push_back(local_row(supernodes[parents[k]], rows_below[s.below + i]));
  }
  return parents;
}

/// Uses two stacks, one for the even and one for the odd levels of the tree. When a supernode pushes its update matrix,
/// those of its children are at the top of the other stack.
void SymbolicCholesky::place_updates(const std::vector<int>& parents) {
  std::vector<int> odd(parents.size());
  for (size_t k = parents.size(); k-- > 0;) odd[k] = parents[k] < 0 ? 0 : 1 - odd[parents[k]];
  size_t top[2] = {}, highest[2] = {};
  for (size_t k = 0; k < parents.size(); ++k) {
    Supernode& s = supernodes[k];
    const int size = 3 * (s.rows - s.columns), stack = odd[k];
    s.update = top[stack];
    top[stack] += size_t(size) * padded(size);
    highest[stack] = std::max(highest[stack], top[stack]);
    if (!s.children.empty()) top[1 - stack] = supernodes[s.children[0]].update;
  }
  for (size_t k = 0; k < parents.size(); ++k)
    if (odd[k]) supernodes[k].update += highest[0];
  updates_size = highest[0] + highest[1];
}

void SymbolicCholesky::place_entries(const SparseMatrix& A) {
  const std::vector<int> position = inverse(order);
  for (Supernode& s : supernodes) {
    s.entries = entries.size();
    for (int j = 0; j < s.columns; ++j)
      for (int c = 0; c < 3; ++c) {
        const int column = 3 * order[s.first + j] + c;
        for (int at = A.outerIndexPtr()[column]; at < A.outerIndexPtr()[column + 1]; ++at) {
          const int row = position[A.innerIndexPtr()[at] / 3], r = A.innerIndexPtr()[at] % 3;
          if (row < s.first + j) continue;  // the other triangle
          entries.push_back({at, 3 * local_row(s, row) + r, 3 * j + c});
        }
      }
  }
}

// --- Factorization ---------------------------------------------------------------------------------------------------

namespace {

/// Packs the rows of `depth` columns into strips of kStrip rows. A strip is stored column by column and padded with
/// zeros.
void pack_strips(Dense columns, Eigen::Index rows, Eigen::Index depth, double* strips) {
  for (Eigen::Index i = 0; i < rows; i += kStrip)
    for (Eigen::Index d = 0; d < depth; ++d, strips += kStrip) {
      const Eigen::Index some = std::min<Eigen::Index>(kStrip, rows - i);
      std::fill(std::copy_n(columns.at(i, d), some, strips), strips + kStrip, 0.0);
    }
}

/// Eliminates the panel's columns and subtracts their product from the update matrix.
bool eliminate_panel(Dense panel, Eigen::Index rows, Eigen::Index columns, Dense update, std::vector<double>& strips) {
  for (Eigen::Index c = 0; c < columns; c += kDepth) {
    const Eigen::Index depth = std::min<Eigen::Index>(kDepth, columns - c), rest = columns - c - depth;
    if (!eliminate_columns(panel, rows, c, c + depth)) return false;
    double* own = strips.data();
    double* below = own + (rest + kStrip) * depth;
    pack_strips({panel.at(c + depth, c), panel.stride}, rest, depth, own);
    pack_strips({panel.at(columns, c), panel.stride}, rows - columns, depth, below);
    subtract_product(own, rest, own, rest, depth, true, {panel.at(c + depth, c + depth), panel.stride});
    subtract_product(below, rows - columns, own, rest, depth, false, {panel.at(columns, c + depth), panel.stride});
    subtract_product(below, rows - columns, below, rows - columns, depth, true, update);
  }
  return true;
}

/// Adds a child's update matrix of size x size blocks to the parent's panel and update matrix.
void add_update(Dense child, int size, const int* in_parent, int columns, Dense panel, Dense update) {
  for (int j = 0; j < size; ++j) {
    const bool own = in_parent[j] < columns;
    const Dense out = own ? Dense{panel.at(0, 3 * in_parent[j]), panel.stride}
                          : Dense{update.at(-3 * columns, 3 * (in_parent[j] - columns)), update.stride};
    for (int c = 0; c < 3; ++c) {
      const double* from = child.at(0, 3 * j + c);
      double* to = out.at(0, c);
      for (int i = j; i < size; ++i)
        for (int r = 0; r < 3; ++r) to[3 * in_parent[i] + r] += from[3 * i + r];
    }
  }
}

}  // namespace

template <class Real>
double BlockCholesky<Real>::factorization_work() const {
  return symbolic_->work;
}

template <class Real>
bool BlockCholesky<Real>::factorize(const SparseMatrix& A) {
  if (!symbolic_ || !symbolic_->has_pattern_of(A)) symbolic_ = std::make_shared<const SymbolicCholesky>(A);
  const SymbolicCholesky& S = *symbolic_;
  factor_.resize(S.factor_size);
  updates_.resize(S.updates_size);
  strips_.resize(size_t(kDepth) * (3 * S.most_rows + 2 * kStrip));
  for (size_t k = 0; k < S.supernodes.size(); ++k) {
    const SymbolicCholesky::Supernode& s = S.supernodes[k];
    const int rows = 3 * s.rows, columns = 3 * s.columns, below = rows - columns;
    panel_.assign(size_t(columns) * padded(rows), 0.0);
    const Dense panel{panel_.data(), padded(rows)}, update{updates_.data() + s.update, padded(below)};
    std::fill_n(update.data, size_t(below) * update.stride, 0.0);
    const size_t end = k + 1 < S.supernodes.size() ? S.supernodes[k + 1].entries : S.entries.size();
    for (size_t e = s.entries; e < end; ++e)
      *panel.at(S.entries[e].row, S.entries[e].column) += A.valuePtr()[S.entries[e].value];
    for (int c : s.children) {
      const SymbolicCholesky::Supernode& child = S.supernodes[c];
      const int size = child.rows - child.columns;
      add_update({updates_.data() + child.update, padded(3 * size)}, size, S.in_parent.data() + child.below, s.columns,
                 panel, update);
    }
    if (!eliminate_panel(panel, rows, columns, update, strips_)) return false;
    for (int c = 0; c < columns; ++c) std::copy_n(panel.at(0, c), rows, factor_.data() + s.factor + size_t(c) * rows);
  }
  return true;
}

// --- Solution --------------------------------------------------------------------------------------------------------

namespace {

/// The kernel for factors of type Real.
template <class Real, class OfDouble, class OfSingle>
constexpr const auto& either(const OfDouble& of_double, const OfSingle& of_single) {
  if constexpr (std::is_same_v<Real, double>)
    return of_double;
  else
    return of_single;
}

}  // namespace

template <class Real>
void BlockCholesky<Real>::forward(const VectorXd& b, std::vector<Real>& y) const {
  const auto& eliminate = either<Real>(forward_double, forward_single);
  const SymbolicCholesky& S = *symbolic_;
  const size_t n = S.order.size();
  y.resize(3 * (n + S.most_rows));
  Real *all = y.data(), *front = all + 3 * n;
  for (size_t k = 0; k < n; ++k)
    for (int c = 0; c < 3; ++c) all[3 * k + c] = Real(b[3 * S.order[k] + c]);
  for (const SymbolicCholesky::Supernode& s : S.supernodes) {
    const int columns = 3 * s.columns, *below = S.rows_below.data() + s.below;
    std::copy_n(all + 3 * s.first, columns, front);
    std::fill_n(front + columns, 3 * s.rows - columns, Real(0));
    eliminate(factor_.data() + s.factor, 3 * s.rows, columns, front);
    std::copy_n(front, columns, all + 3 * s.first);
    for (int i = s.columns; i < s.rows; ++i, ++below)
      for (int c = 0; c < 3; ++c) all[3 * *below + c] += front[3 * i + c];
  }
}

template <class Real>
void BlockCholesky<Real>::backward(std::vector<Real>& y, VectorXd& x) const {
  const auto& substitute = either<Real>(backward_double, backward_single);
  const SymbolicCholesky& S = *symbolic_;
  const size_t n = S.order.size();
  Real *all = y.data(), *front = all + 3 * n;
  for (size_t k = S.supernodes.size(); k-- > 0;) {
    const SymbolicCholesky::Supernode& s = S.supernodes[k];
    const int columns = 3 * s.columns, *below = S.rows_below.data() + s.below;
    std::copy_n(all + 3 * s.first, columns, front);
    for (int i = s.columns; i < s.rows; ++i, ++below) std::copy_n(all + 3 * *below, 3, front + 3 * i);
    substitute(factor_.data() + s.factor, 3 * s.rows, columns, front);
    std::copy_n(front, columns, all + 3 * s.first);
  }
  x.resize(3 * n);
  for (size_t k = 0; k < n; ++k)
    for (int c = 0; c < 3; ++c) x[3 * S.order[k] + c] = all[3 * k + c];
}

template <class Real>
void BlockCholesky<Real>::solve(const VectorXd& b, VectorXd& x, std::vector<Real>& scratch) const {
  forward(b, scratch);
  backward(scratch, x);
}

template <class Real>
VectorXd BlockCholesky<Real>::solve(const VectorXd& b) const {
  VectorXd x;
  std::vector<Real> scratch;
  solve(b, x, scratch);
  return x;
}

template <class Real>
void BlockCholesky<Real>::forward_sides(Real* X) const {
  const auto& eliminate = either<Real>(forward_sides_double, forward_sides_single);
  for (const SymbolicCholesky::Supernode& s : symbolic_->supernodes) {
    const int columns = 3 * s.columns;
    const Real* own = X + size_t(3 * s.first) * kSides;
    if (std::all_of(own, own + size_t(columns) * kSides, [](Real x) { return x == 0; })) continue;
    eliminate(factor_.data() + s.factor, symbolic_->rows_below.data() + s.below, 3 * s.first, 3 * s.rows, columns, X);
  }
}

template <class Real>
void BlockCholesky<Real>::backward_sides(Real* X) const {
  const auto& substitute = either<Real>(backward_sides_double, backward_sides_single);
  for (size_t k = symbolic_->supernodes.size(); k-- > 0;) {
    const SymbolicCholesky::Supernode& s = symbolic_->supernodes[k];
    substitute(factor_.data() + s.factor, symbolic_->rows_below.data() + s.below, 3 * s.first, 3 * s.rows,
               3 * s.columns, X);
  }
}

namespace {

/// Calls move(side, x) for kSides columns of X from the first on, in the order of the factor, with the numbers of sides
/// (3n, kSides).
template <class Real, class Matrix, class Move>
void exchange(const SymbolicCholesky& S, std::vector<Real>& sides, Matrix& X, Eigen::Index first, const Move& move) {
  const Eigen::Index some = std::min<Eigen::Index>(kSides, X.cols() - first);
  for (size_t k = 0; k < S.order.size(); ++k)
    for (int c = 0; c < 3; ++c)
      for (Eigen::Index side = 0; side < some; ++side)
        move(sides[(3 * k + c) * kSides + side], X(3 * S.order[k] + c, first + side));
}

}  // namespace

template <class Real>
void BlockCholesky<Real>::solve_in_place(Eigen::Ref<MatrixXd> X) const {
  std::vector<Real> sides(X.rows() * kSides);
  for (Eigen::Index first = 0; first < X.cols(); first += kSides) {
    exchange(*symbolic_, sides, X, first, [](Real& side, double x) { side = Real(x); });
    forward_sides(sides.data());
    backward_sides(sides.data());
    exchange(*symbolic_, sides, X, first, [](Real side, double& x) { x = side; });
  }
}

template <class Real>
typename BlockCholesky<Real>::Columns BlockCholesky<Real>::forward(const MatrixXd& X) const {
  std::vector<Real> sides(X.rows() * kSides);
  Columns out(X.rows(), X.cols());
  for (Eigen::Index first = 0; first < X.cols(); first += kSides) {
    const Eigen::Index some = std::min<Eigen::Index>(kSides, X.cols() - first);
    exchange(*symbolic_, sides, X, first, [](Real& side, double x) { side = Real(x); });
    forward_sides(sides.data());
    using Sides = Eigen::Matrix<Real, Eigen::Dynamic, kSides, Eigen::RowMajor>;
    out.middleCols(first, some) = Eigen::Map<const Sides>(sides.data(), X.rows(), kSides).leftCols(some);
  }
  return out;
}

template class BlockCholesky<float>;
template class BlockCholesky<double>;

}  // namespace dynamorph
