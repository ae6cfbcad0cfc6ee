// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "dynamorph/reduced/modes/polynomials.hpp"
#include "dynamorph/reduced/responses/response_basis.hpp"

namespace dynamorph {

/// Tables of every target of `model`, with responses: see ReducedTables. Throws like `reduce`.
ReducedTables reduce(const FullModel& model, const ResponseBasis& basis, const ProgressFn& progress = {});

}  // namespace dynamorph
