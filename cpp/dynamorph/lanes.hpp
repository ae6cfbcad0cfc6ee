// SPDX-License-Identifier: GPL-3.0-or-later
// Eight numbers that go through the same arithmetic. GCC's vectors: whatever the processor has carries them out.
#pragma once

#include <new>
#include <vector>

#include "dynamorph/multiversion.hpp"
#include "dynamorph/types.hpp"

// Vectors wider than the baseline's registers are only passed between functions that are inlined.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace dynamorph {

constexpr int kLanes = 8;
using Floats = float __attribute__((vector_size(32)));
using Doubles = double __attribute__((vector_size(64)));

/// Of lanes, aligned as every instruction set wants it: the baseline alone would ask for less.
template <class T>
struct CacheAligned {
  using value_type = T;
  CacheAligned() = default;
  template <class U>
  CacheAligned(const CacheAligned<U>&) {}
  T* allocate(std::size_t n) { return static_cast<T*>(::operator new(n * sizeof(T), std::align_val_t(64))); }
  void deallocate(T* p, std::size_t) { ::operator delete(p, std::align_val_t(64)); }
  bool operator==(const CacheAligned&) const { return true; }
  bool operator!=(const CacheAligned&) const { return false; }
};
template <class T>
using LaneVector = std::vector<T, CacheAligned<T>>;

DYNAMORPH_INLINE void to_single(const double& from, float& to) { to = float(from); }
DYNAMORPH_INLINE void to_single(const Doubles& from, Floats& to) { to = __builtin_convertvector(from, Floats); }

}  // namespace dynamorph
