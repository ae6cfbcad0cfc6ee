// SPDX-License-Identifier: GPL-3.0-or-later
// The choices of a step's motion limit: numbers that no theory gives, and why they are what they are. docs/choices.md
// has what each of them decides (`make -C evidence choices`).
#pragma once

namespace dynamorph {

/// Of the limit: as far as the heaviest load may let the skin swing, so that it is pulled back in few steps. With 1,
/// fish out of water stretch edges by up to 1.65; with 0.85, the peak of a hard blow depends by more than 8 % on the
/// step, and with 0.75 a linear key on every frame moves the skin by more than 15 % otherwise than smooth keys.
constexpr double kLoadSwing = 0.9;
constexpr double kLoadBegins = 0.4;  ///< of that: beyond, a load is scaled down
/// Of the critical damping, of the oscillator that a load drives. With 0.5, loads that oscillate cancel in it as in a
/// mean; with 0.25, it remembers a bad frame of the rig for longer than two swings.
constexpr double kLoadDamping = 0.3;
/// m w^2, the stiffness that gives a point its tissue's frequency, by which it is pulled back. With 10, a bar with
/// hardly any damping that is shaken at its own frequency goes to 1.5 of its limit, with 20 to 1.3, with 30 to 1.2.
constexpr double kPull = 30;
constexpr double kRampBegins = 0.6;   ///< of a limit: from there on something is pulled back
constexpr double kWatched = 0.45;     ///< of a limit: what is nearer at first is not pulled in this step
constexpr double kPercentile = 0.97;  ///< of a bone's skin; spikes and slivers that only ride along must not decide
constexpr double kEdgePercentile = 0.998;
constexpr double kOwns = 0.25;          ///< a bone with more weight than that owns the skin
constexpr int kLimitedPoints = 100;     ///< sampled on the skin
constexpr int kPointsOfBone = 4;        ///< at least, of a bone with tissue
constexpr int kPaintedPoints = 30;      ///< at least, where the limit is painted smaller
constexpr double kBoneOfTissue = 1e-3;  ///< of the mass; bones with less have no edges and need no points

}  // namespace dynamorph
