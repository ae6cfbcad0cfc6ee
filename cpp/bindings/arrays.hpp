// SPDX-License-Identifier: GPL-3.0-or-later
// Converts NumPy arrays to Eigen matrices. Errors name the parameter.
#pragma once

#include <pybind11/numpy.h>

#include <Eigen/Dense>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "dynamorph/pose/skinning.hpp"

namespace py = pybind11;

namespace dynamorph {

using FloatArray = py::array_t<double, py::array::c_style | py::array::forcecast>;

/// An argument that holds node or vertex indices. It accepts any type, so that `to_indices` can say what is wrong.
struct IndexArray : py::array {
  using py::array::array;
};

/// "(4, 3)"
inline std::string shape_of(const py::array& array) { return py::repr(array.attr("shape")).cast<std::string>(); }

/// Copies a two-dimensional array into a row-major Matrix. If the Matrix has a fixed number of columns, the array must
/// have as many. Throws std::invalid_argument (ValueError), which names `name`, the expected and the actual shape.
template <class Matrix, class Array>
Matrix to_matrix(const Array& array, const char* name) {
  constexpr int columns = Matrix::ColsAtCompileTime;
  if (array.ndim() != 2 || (columns != Eigen::Dynamic && array.shape(1) != columns))
    throw std::invalid_argument(std::string(name) + ": expected shape (any, " +
                                (columns == Eigen::Dynamic ? "any" : std::to_string(columns)) + "), got " +
                                shape_of(array));
  using Stored = Eigen::Matrix<typename Matrix::Scalar, Eigen::Dynamic, columns, Eigen::RowMajor>;
  return Eigen::Map<const Stored>(array.data(), array.shape(0), array.shape(1));
}

/// Copies indices into a row-major Matrix of 32-bit integers. Throws std::invalid_argument like `to_matrix`, and also
/// when the type is not an integer type or a number does not fit, because NumPy would truncate or wrap it.
template <class Matrix>
Matrix to_indices(const IndexArray& array, const char* name) {
  const char kind = array.dtype().kind();
  if (array.size() > 0 && kind != 'i' && kind != 'u')
    throw std::invalid_argument(std::string(name) + ": expected integers, got " +
                                py::str(array.dtype()).cast<std::string>());
  using Wide = Eigen::Matrix<std::int64_t, Eigen::Dynamic, Matrix::ColsAtCompileTime, Eigen::RowMajor>;
  const py::array_t<std::int64_t, py::array::c_style | py::array::forcecast> whole(array);
  const Wide wide = to_matrix<Wide>(whole, name);
  const bool wraps = kind == 'u' && array.itemsize() == 8;  // numbers from 2^63 up become negative
  constexpr std::int64_t largest = std::numeric_limits<std::int32_t>::max();
  if (wide.size() > 0 && (wide.maxCoeff() > largest || wide.minCoeff() < (wraps ? 0 : -largest)))
    throw std::invalid_argument(std::string(name) + ": expected indices up to " + std::to_string(largest) + ", got " +
                                py::str(array.attr("min")()).cast<std::string>() + " to " +
                                py::str(array.attr("max")()).cast<std::string>());
  return wide.template cast<std::int32_t>();
}

/// -1 in `expected` stands for any size.
inline void check_shape(const char* name, const py::array& array, const std::vector<py::ssize_t>& expected) {
  bool good = array.ndim() == py::ssize_t(expected.size());
  for (size_t i = 0; good && i < expected.size(); ++i) good = expected[i] < 0 || array.shape(i) == expected[i];
  if (good) return;
  std::string text;
  for (py::ssize_t e : expected) text += (text.empty() ? "" : ", ") + (e < 0 ? std::string("any") : std::to_string(e));
  throw std::invalid_argument(std::string(name) + ": expected shape (" + text + "), got " + shape_of(array));
}

/// Throws std::invalid_argument when one of the numbers is NaN or infinite. They are an Eigen expression.
template <class Numbers>
void check_finite(const char* name, const Numbers& numbers) {
  if (!numbers.allFinite()) throw std::invalid_argument(std::string(name) + ": must be finite");
}

/// Flattens points (rows, 3) to x0 y0 z0 x1 ... If `rows` is -1, any number is accepted.
inline VectorXd flat_points(const char* name, const FloatArray& array, py::ssize_t rows) {
  check_shape(name, array, {rows, 3});
  return Eigen::Map<const VectorXd>(array.data(), array.size());
}

inline Transforms transforms(const double* data, py::ssize_t bones) {
  return Eigen::Map<const Transforms>(data, bones, 12);
}

/// Transforms (B, 3, 4), one per row.
inline Transforms transforms(const char* name, const FloatArray& array) {
  check_shape(name, array, {-1, 3, 4});
  return transforms(array.data(), array.shape(0));
}

}  // namespace dynamorph

namespace pybind11::detail {

/// Accepts what NumPy accepts: arrays of any type, and lists.
template <>
struct type_caster<dynamorph::IndexArray> {
  using Narrow = type_caster<array_t<std::int32_t, array::c_style | array::forcecast>>;
  PYBIND11_TYPE_CASTER(dynamorph::IndexArray, Narrow::name);
  bool load(handle source, bool) {
    value = reinterpret_steal<dynamorph::IndexArray>(array::ensure(source).release());
    return bool(value);
  }
};

}  // namespace pybind11::detail
