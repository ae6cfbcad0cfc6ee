// SPDX-License-Identifier: GPL-3.0-or-later
// Motions of a body that nothing resists.
//
// A small motion costs no energy if it moves every tet rigidly, u(x) = v + omega x X, and leaves the nodes that are
// pinned or held in place. Tets with a common face move alike then; those with only a common edge can fold about it,
// and those with only a common corner can turn about it. So whether there is such a motion depends neither on stiffness
// nor on the eigensolver's round-off, but only on where the nodes are that are pinned, held or shared.
#pragma once

#include "dynamorph/models/soft_body.hpp"

namespace dynamorph {

/// Throws Error, which says what can move and what to do, if nothing resists some motion of the body about its rest
/// shape.
void check_no_free_motion(const SoftBody& body);

}  // namespace dynamorph
