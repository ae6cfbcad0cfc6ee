// SPDX-License-Identifier: GPL-3.0-or-later
// What kernels ask of the compiler, and GCC and Clang (of any system) spell differently. No includes: see dispatch.hpp.
#pragma once

#include <stddef.h>

namespace dynamorph {

using Index = ptrdiff_t;  // as Eigen's

}  // namespace dynamorph

/// A function that becomes part of its caller, whatever instruction set that is compiled for.
#define DYNAMORPH_INLINE inline __attribute__((always_inline))

/// Before a loop: no iteration reads what another writes.
#if defined(__clang__)
#define DYNAMORPH_INDEPENDENT _Pragma("clang loop vectorize(assume_safety)")
#else
#define DYNAMORPH_INDEPENDENT _Pragma("GCC ivdep")
#endif
