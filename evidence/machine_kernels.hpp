// SPDX-License-Identifier: GPL-3.0-or-later
// What the machine can do at most, with the instruction set that the engine uses.
#pragma once

#include "dynamorph/simd/compiler.hpp"
#include "dynamorph/simd/dispatch.hpp"

namespace dynamorph {

constexpr int kChains = 12;  ///< of dependent operations: enough to fill the latency of two units

/// Multiplies and adds, `rounds` times in each chain, eight floats or four doubles at once.
DYNAMORPH_KERNEL(double, operate_on_floats, int rounds);
DYNAMORPH_KERNEL(double, operate_on_doubles, int rounds);

/// The sum of whole blocks of 32.
DYNAMORPH_KERNEL(double, read_through, const double* data, Index size);

}  // namespace dynamorph
