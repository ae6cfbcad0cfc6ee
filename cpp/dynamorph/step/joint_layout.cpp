// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/step/joint_layout.hpp"

namespace dynamorph {

using Eigen::Index;

template <>
JointLayout<SparseMatrix>::JointLayout(const std::vector<SparseMatrix>& patterns) {
  Index values = 0;
  for (const SparseMatrix& pattern : patterns) {
    ranges_.push_back({{0, dofs_, pattern.rows()}});
    first_value_.push_back(values);
    dofs_ += pattern.rows();
    values += pattern.nonZeros();
  }
  zero_.resize(dofs_, dofs_);
  zero_.reserve(values);
  for (std::size_t model = 0; model < patterns.size(); ++model) {
    const Index first = ranges_[model][0].all;
    for (Index column = 0; column < patterns[model].cols(); ++column) {
      zero_.startVec(first + column);
      for (SparseMatrix::InnerIterator it(patterns[model], column); it; ++it)
        zero_.insertBack(first + it.row(), first + column) = 0;
    }
  }
  zero_.finalize();
}

template <>
JointLayout<ArrowMatrix>::JointLayout(const std::vector<ArrowMatrix>& patterns) {
  Index modes = 0, responses = 0;
  for (const ArrowMatrix& pattern : patterns) modes += pattern.corner_size();
  for (const ArrowMatrix& pattern : patterns) {
    const Index r = pattern.corner_size(), h = pattern.rows() - r;
    const Index before = ranges_.empty() ? 0 : ranges_.back()[0].all + ranges_.back()[0].size;
    ranges_.push_back({{0, before, r}, {r, modes + responses, h}});
    responses += h;
  }
  dofs_ = modes + responses;
  zero_ = ArrowMatrix(modes, responses);
}

template <>
void JointLayout<SparseMatrix>::put(const SparseMatrix& own, std::size_t model, SparseMatrix& all) const {
  values(all).segment(first_value_[model], own.nonZeros()) = values(own);
}

template <>
void JointLayout<ArrowMatrix>::put(const ArrowMatrix& own, std::size_t model, ArrowMatrix& all) const {
  const Range modes = ranges_[model][0], responses = ranges_[model][1];
  const Index from = responses.all - zero_.corner_size();
  all.corner().block(modes.all, modes.all, modes.size, modes.size) = own.corner();
  all.border().block(from, modes.all, responses.size, modes.size) = own.border();
  all.rest().segment(from, responses.size) = own.rest();
}

template <>
void JointLayout<SparseMatrix>::join(const std::vector<const SparseRows*>& own, SparseRows& all) const {
  Index rows = 0, parts = 0;
  for (const SparseRows* each : own)
    if (each) rows = each->rows(), parts += each->parts.rows();
  all.ends.clear();
  all.parts.resize(parts, dofs_);
  int made = 0;
  for (Index row = 0; row < rows; ++row) {
    for (std::size_t model = 0; model < own.size(); ++model) {
      if (!own[model]) continue;
      for (int part = own[model]->first(row); part < own[model]->ends[std::size_t(row)]; ++part, ++made) {
        all.parts.startVec(made);
        for (Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator it(own[model]->parts, part); it; ++it)
          all.parts.insertBack(made, ranges_[model][0].all + it.col()) = it.value();
      }
    }
    all.ends.push_back(made);
  }
  all.parts.finalize();
}

template <>
void JointLayout<ArrowMatrix>::join(const std::vector<const RowMajor*>& own, RowMajor& all) const {
  for (const RowMajor* each : own)
    if (each) all.setZero(each->rows(), dofs_);
  for (std::size_t model = 0; model < own.size(); ++model)
    for (const Range& range : ranges_[model])
      if (own[model]) all.middleCols(range.all, range.size) = own[model]->middleCols(range.own, range.size);
}

}  // namespace dynamorph
