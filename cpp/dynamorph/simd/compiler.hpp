// SPDX-License-Identifier: GPL-3.0-or-later
// Compiler features that kernels need, which GCC and Clang (on any system) spell differently. This file includes no C++
// headers: see dispatch.hpp.
#pragma once

#include <stddef.h>

namespace dynamorph {

using Index = ptrdiff_t;  // as in Eigen

}  // namespace dynamorph

/// A function that is always inlined, whatever instruction set its caller is compiled for.
#define DYNAMORPH_INLINE inline __attribute__((always_inline))

/// Placed before a loop in which no iteration reads what another writes.
#if defined(__clang__)
#define DYNAMORPH_INDEPENDENT _Pragma("clang loop vectorize(assume_safety)")
#else
#define DYNAMORPH_INDEPENDENT _Pragma("GCC ivdep")
#endif
