// SPDX-License-Identifier: GPL-3.0-or-later
// Loops compiled for several instruction sets and chosen when loaded, so that a wheel built for any x86-64 uses AVX2 or
// AVX-512 where the machine has it. Only of functions that are no templates; what they call must be inlined into them,
// lambdas too unless they leave wide vectors alone.
#pragma once

#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__)
#define DYNAMORPH_MULTIVERSION __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define DYNAMORPH_MULTIVERSION
#endif
#define DYNAMORPH_INLINE inline __attribute__((always_inline))
