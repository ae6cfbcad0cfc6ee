// SPDX-License-Identifier: GPL-3.0-or-later
// Several models of one kind as one, for a Newton's method over the coordinates of all: where those of each are among
// all, and its matrices and rows in those of all. A mesh's nodes follow each other; of reduced models the modes of all
// come first, then the responses of all, so that their matrices are one arrow.
#pragma once

#include <vector>

#include "dynamorph/step/hessian.hpp"

namespace dynamorph {

template <class Matrix>
class JointLayout {
 public:
  using Points = PointStiffness<Matrix>;
  using Rows = decltype(Points::rows);
  using Index = Eigen::Index;

  /// patterns: a zero matrix of each model.
  explicit JointLayout(const std::vector<Matrix>& patterns);

  Index dofs() const { return dofs_; }
  /// A zero matrix of all.
  const Matrix& zero() const { return zero_; }

  /// The coordinates of a model out of those of all.
  void take(const VectorXd& all, std::size_t model, VectorXd& own) const {
    own.resize(ranges_[model].back().own + ranges_[model].back().size);
    for (const Range& range : ranges_[model]) own.segment(range.own, range.size) = all.segment(range.all, range.size);
  }
  /// And into them.
  void put(const VectorXd& own, std::size_t model, VectorXd& all) const {
    for (const Range& range : ranges_[model]) all.segment(range.all, range.size) = own.segment(range.own, range.size);
  }

  /// Writes a model's matrix into that of all.
  void put(const Matrix& own, std::size_t model, Matrix& all) const;
  /// Rows over the coordinates of all (k, dofs), each the sum of those of the models (k), one at least; null: none.
  void join(const std::vector<const Rows*>& own, Rows& all) const;

 private:
  struct Range {
    Index own, all, size;
  };
  std::vector<std::vector<Range>> ranges_;  ///< of each model
  std::vector<Index> first_value_;          ///< of each model's matrix, of a mesh
  Index dofs_ = 0;
  Matrix zero_;
};

template <>
JointLayout<SparseMatrix>::JointLayout(const std::vector<SparseMatrix>& patterns);
template <>
JointLayout<ArrowMatrix>::JointLayout(const std::vector<ArrowMatrix>& patterns);
template <>
void JointLayout<SparseMatrix>::put(const SparseMatrix& own, std::size_t model, SparseMatrix& all) const;
template <>
void JointLayout<ArrowMatrix>::put(const ArrowMatrix& own, std::size_t model, ArrowMatrix& all) const;
template <>
void JointLayout<SparseMatrix>::join(const std::vector<const SparseRows*>& own, SparseRows& all) const;
template <>
void JointLayout<ArrowMatrix>::join(const std::vector<const RowMajor*>& own, RowMajor& all) const;

}  // namespace dynamorph
