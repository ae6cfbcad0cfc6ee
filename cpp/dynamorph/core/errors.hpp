// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <stdexcept>
#include <string>

namespace dynamorph {

/// Bad data (mesh, tetrahedra, eigensolver). The message says what the artist can do about it.
/// A caller's mistake (shape, range) throws std::invalid_argument instead.
struct Error : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Throws std::invalid_argument for a value below zero, or not finite.
inline void check_not_negative(const char* name, double value) {
  if (!(value >= 0) || !std::isfinite(value))
    throw std::invalid_argument(std::string(name) + ": must be finite and not negative");
}

/// Throws std::invalid_argument unless both sizes are equal.
inline void check_size(const char* name, Eigen::Index actual, Eigen::Index expected) {
  if (actual != expected)
    throw std::invalid_argument(std::string(name) + ": expected " + std::to_string(expected) + " rows, got " +
                                std::to_string(actual));
}

}  // namespace dynamorph
