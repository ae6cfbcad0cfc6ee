// SPDX-License-Identifier: GPL-3.0-or-later
// NumPy arrays in, Eigen matrices out, with errors that name the parameter.
#pragma once

#include <pybind11/numpy.h>

#include <Eigen/Dense>
#include <string>

using FloatArray = pybind11::array_t<double, pybind11::array::c_style | pybind11::array::forcecast>;
using IntArray = pybind11::array_t<std::int32_t, pybind11::array::c_style | pybind11::array::forcecast>;

/// "(4, 3)"
inline std::string shape_of(const pybind11::array& array) {
  return pybind11::repr(array.attr("shape")).cast<std::string>();
}

/// A copy of a two-dimensional array as a row-major Matrix, whose column count, if fixed, it must have.
/// Throws std::invalid_argument (ValueError) naming `name`, the expected and the actual shape.
template <class Matrix, class Array>
Matrix to_matrix(const Array& array, const char* name) {
  constexpr int columns = Matrix::ColsAtCompileTime;
  if (array.ndim() != 2 || (columns != Eigen::Dynamic && array.shape(1) != columns))
    throw std::invalid_argument(std::string(name) + ": expected shape (any, " +
                                (columns == Eigen::Dynamic ? "any" : std::to_string(columns)) + "), got " +
                                shape_of(array));
  using RowMajor = Eigen::Matrix<typename Matrix::Scalar, Eigen::Dynamic, columns, Eigen::RowMajor>;
  return Eigen::Map<const RowMajor>(array.data(), array.shape(0), array.shape(1));
}
