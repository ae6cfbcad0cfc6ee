// SPDX-License-Identifier: GPL-3.0-or-later
// Arrays of a model file as matrices, of the expected type and shape.
#pragma once

#include <initializer_list>
#include <type_traits>

#include "dynamorph/core/types.hpp"
#include "dynamorph/file/model_file.hpp"

namespace dynamorph::file {

template <class Number>
using Table = Eigen::Map<const Eigen::Matrix<Number, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>;

inline Error incomplete(const std::string& what) {
  return Error("The stored model is incomplete (" + what + "). Build it again.");
}

constexpr const char* dtype_of(double) { return "F64"; }
constexpr const char* dtype_of(float) { return "F32"; }
constexpr const char* dtype_of(std::int32_t) { return "I32"; }
constexpr const char* dtype_of(std::uint8_t) { return "BOOL"; }

/// A view (first dimension, all others) of an array in `content`. -1 in `shape` stands for any size.
template <class Number>
Table<Number> table(const Content& content, const std::string& name, std::initializer_list<Eigen::Index> shape) {
  const Array* array = content.find(name);
  if (!array || array->dtype != dtype_of(Number()) || array->shape.size() != shape.size()) throw incomplete(name);
  Eigen::Index rows = array->shape[0], columns = 1, axis = 0;
  for (Eigen::Index expected : shape) {
    const Eigen::Index size = array->shape[std::size_t(axis)];
    if (expected >= 0 && size != expected) throw incomplete(name);
    if (axis++ > 0) columns *= size;
  }
  const Table<Number> out(reinterpret_cast<const Number*>(array->bytes.data()), rows, columns);
  if (std::is_floating_point_v<Number> && !out.allFinite()) throw incomplete(name);
  return out;
}

}  // namespace dynamorph::file
