// SPDX-License-Identifier: GPL-3.0-or-later
// How a long call reports its progress and is asked to stop.
#pragma once

#include <functional>
#include <stdexcept>

namespace dynamorph {

/// Thrown by a long call when its progress function returned false.
struct Cancelled : std::runtime_error {
  Cancelled() : std::runtime_error("canceled") {}
};

/// Called with the fraction done, 0..1. Returning false asks the call to stop.
using ProgressFn = std::function<bool(double)>;

inline void report(const ProgressFn& progress, double fraction) {
  if (progress && !progress(fraction)) throw Cancelled();
}

}  // namespace dynamorph
