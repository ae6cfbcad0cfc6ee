// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/reduced/modes/gram_accumulator.hpp"

#include <algorithm>

#include "dynamorph/core/parallel.hpp"
#include "dynamorph/reduced/modes/gram_kernels.hpp"

namespace dynamorph {

namespace {

Index tiles_for(Index size) { return (size + kTile - 1) / kTile; }

/// Packs row `at` of a batch into panels.
void pack(const double* row, Index size, Index at, double* panels) {
  panels += at * kTile;
  Index i = 0;
  for (; i + kTile <= size; i += kTile, panels += kDepth * kTile) std::copy_n(row + i, kTile, panels);
  std::copy_n(row + i, size - i, panels);
}

}  // namespace

GramAccumulator::GramAccumulator(Index n) : GramAccumulator(n, n, [](Index i) { return i; }) {
  a_.clear();
  a_.shrink_to_fit();
}

GramAccumulator::GramAccumulator(Index m, Index n, const std::function<Index(Index)>& first) : m_(m), n_(n) {
  Index tiles = 0;
  for (Index i = 0; i < tiles_for(m); ++i) {
    first_.push_back(first(i * kTile) / kTile);
    start_.push_back(tiles);
    tiles += tiles_for(n) - first_[i];
  }
  tiles_.resize(tiles * kTile * kTile);
  a_.resize(tiles_for(m) * kDepth * kTile);
  b_.resize(tiles_for(n) * kDepth * kTile);
}

void GramAccumulator::add(const double* row) {
  pack(row, n_, filled_, b_.data());
  if (++filled_ == kDepth) finish();
}

void GramAccumulator::add(const double* a, const double* b) {
  pack(a, m_, filled_, a_.data());
  add(b);
}

void GramAccumulator::finish() {
  const double* A = a_.empty() ? b_.data() : a_.data();
  for (Index i = 0; i < tiles_for(m_); ++i)
    multiply_panels(A + i * kDepth * kTile, b_.data() + first_[i] * kDepth * kTile, tiles_for(n_) - first_[i], filled_,
                    tiles_.data() + start_[i] * kTile * kTile);
  filled_ = 0;
}

double GramAccumulator::operator()(Index i, Index j) const {
  const Index row = i / kTile;
  return tiles_[((start_[row] + j / kTile - first_[row]) * kTile + i % kTile) * kTile + j % kTile];
}

namespace {

constexpr Index kRows = 1024;  ///< of a part of a product, at least
constexpr Index kSums = 8;     ///< at most, because each takes the memory of the result

Index parts_of(Index rows, Index each) { return (rows + each - 1) / each; }

/// Calls work(part, first row, its end) for parts of `each` rows.
template <class Work>
void by_rows(Index rows, Index each, const Work& work) {
  run_tasks(int(parts_of(rows, each)), {},
            [&](int part, const ProgressFn&) { work(part, part * each, std::min(rows, (part + 1) * each)); });
}

/// The sum of what of_rows(first, end) gives for parts of so many rows.
template <class OfRows>
MatrixXd summed(Index rows, MatrixXd sum, const OfRows& of_rows) {
  const Index each = std::max(kRows, parts_of(rows, kSums));
  std::vector<MatrixXd> parts(parts_of(rows, each));
  by_rows(rows, each, [&](int part, Index first, Index end) { parts[part] = of_rows(first, end); });
  for (const MatrixXd& part : parts) sum += part;
  return sum;
}

}  // namespace

MatrixXd gram(const RowMajor& A) {
  return summed(A.rows(), MatrixXd::Zero(A.cols(), A.cols()), [&](Index first, Index end) {
    GramAccumulator products(A.cols());
    for (Index row = first; row < end; ++row) products.add(A.row(row).data());
    products.finish();
    MatrixXd out = MatrixXd::Zero(A.cols(), A.cols());
    for (Index j = 0; j < A.cols(); ++j)
      for (Index i = j; i < A.cols(); ++i) out(i, j) = products(j, i);
    return out;
  });
}

MatrixXd inner_products(const RowMajor& A, const RowMajor& B) {
  return summed(A.rows(), MatrixXd::Zero(A.cols(), B.cols()), [&](Index first, Index end) {
    GramAccumulator products(A.cols(), B.cols(), [](Index) { return 0; });
    for (Index row = first; row < end; ++row) products.add(A.row(row).data(), B.row(row).data());
    products.finish();
    MatrixXd out(A.cols(), B.cols());
    for (Index j = 0; j < B.cols(); ++j)
      for (Index i = 0; i < A.cols(); ++i) out(i, j) = products(i, j);
    return out;
  });
}

RowMajor product(const RowMajor& A, const RowMajor& B) {
  RowMajor out(A.rows(), B.cols());
  by_rows(A.rows(), kRows, [&](int, Index first, Index end) {
    const RowMajor columns = A.middleRows(first, end - first).transpose();
    GramAccumulator products(end - first, B.cols(), [](Index) { return 0; });
    for (Index k = 0; k < columns.rows(); ++k) products.add(columns.row(k).data(), B.row(k).data());
    products.finish();
    for (Index i = first; i < end; ++i)
      for (Index j = 0; j < B.cols(); ++j) out(i, j) = products(i - first, j);
  });
  return out;
}

}  // namespace dynamorph
