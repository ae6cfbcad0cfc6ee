// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <memory>

#include "arrays.hpp"
#include "dynamorph/contact/collider.hpp"

namespace dynamorph {

/// A collider during S steps, in world space, meters: its transforms (S + 1, 3, 4) or its points (S + 1, V, 3), the
/// first at the beginning of the first step.
struct ColliderMotion {
  std::shared_ptr<const Collider> collider;
  FloatArray motion;
  VectorXd friction;         ///< (S)
  std::vector<bool> active;  ///< (S)

  py::ssize_t steps() const { return motion.shape(0) - 1; }
  ColliderStep at(py::ssize_t step) const {
    const py::ssize_t rows = motion.shape(1), columns = motion.shape(2);
    const double* before = motion.data() + step * rows * columns;
    return {*collider,
            {before, rows, columns},
            {before + rows * columns, rows, columns},
            friction(step),
            active[std::size_t(step)]};
  }
};

}  // namespace dynamorph
