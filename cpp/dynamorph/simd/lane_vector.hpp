// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <new>
#include <vector>

#include "dynamorph/simd/lanes.hpp"

namespace dynamorph {

/// Allocates whole cache lines, so that what kernels read there does not straddle two.
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

}  // namespace dynamorph
