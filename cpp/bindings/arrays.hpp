// SPDX-License-Identifier: GPL-3.0-or-later
// NumPy arrays in, Eigen matrices out, with errors that name the parameter.
#pragma once

#include <pybind11/numpy.h>

#include <Eigen/Dense>
#include <string>
#include <vector>

#include "dynamorph/pose/skinning.hpp"

namespace py = pybind11;

namespace dynamorph {

using FloatArray = py::array_t<double, py::array::c_style | py::array::forcecast>;
using IntArray = py::array_t<std::int32_t, py::array::c_style | py::array::forcecast>;

/// "(4, 3)"
inline std::string shape_of(const py::array& array) { return py::repr(array.attr("shape")).cast<std::string>(); }

/// A copy of a two-dimensional array as a row-major Matrix, whose column count, if fixed, it must have.
/// Throws std::invalid_argument (ValueError) naming `name`, the expected and the actual shape.
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

/// -1 in `expected` stands for any size.
inline void check_shape(const char* name, const py::array& array, const std::vector<py::ssize_t>& expected) {
  bool good = array.ndim() == py::ssize_t(expected.size());
  for (size_t i = 0; good && i < expected.size(); ++i) good = expected[i] < 0 || array.shape(i) == expected[i];
  if (good) return;
  std::string text;
  for (py::ssize_t e : expected) text += (text.empty() ? "" : ", ") + (e < 0 ? std::string("any") : std::to_string(e));
  throw std::invalid_argument(std::string(name) + ": expected shape (" + text + "), got " + shape_of(array));
}

/// Points (rows, 3) as x0 y0 z0 x1 ...; -1 rows: any number.
inline VectorXd flat_points(const char* name, const FloatArray& array, py::ssize_t rows) {
  check_shape(name, array, {rows, 3});
  return Eigen::Map<const VectorXd>(array.data(), array.size());
}

inline Transforms transforms(const double* data, py::ssize_t bones) {
  return Eigen::Map<const Transforms>(data, bones, 12);
}

/// Transforms (B, 3, 4), one a row.
inline Transforms transforms(const char* name, const FloatArray& array) {
  check_shape(name, array, {-1, 3, 4});
  return transforms(array.data(), array.shape(0));
}

}  // namespace dynamorph
