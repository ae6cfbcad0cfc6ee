// SPDX-License-Identifier: GPL-3.0-or-later
// The choices of contact: numbers that no theory gives, and why they are what they are. docs/choices.md has what each
// of them decides (`make -C evidence choices`).
#pragma once

namespace dynamorph {

// How firmly skin is pushed.
constexpr double kContactWidth = 1e-3;     ///< of the body's size: the depth over which contact gets its full stiffness
constexpr double kFirmness = 30;           ///< times the stiffness of the body: what is left of a dent is 1/30
constexpr double kFree = 0.3;              ///< of a sample's weights on free nodes; with less, pins hold it
constexpr double kFirmStep = 2. / 3 / 96;  ///< s, where its mass is fitted: c h of BDF2 at 24 fps and 4 substeps
constexpr double kSticks = 1e-3;           ///< of the size, per second: what slips slower than that is held by friction

// Where colliders are looked for.
constexpr double kContactMargin = 0.02;  ///< of the size: samples that come so near in a step can touch something
constexpr double kContactNear = 0.005;   ///< of the size: those that hardly move, only if they come so near
constexpr double kSeen = 3;  ///< thicknesses of tissue in which a collider is looked for that is gone through

// What the bones take into a collider by more than this, in thicknesses of tissue, has less weight, and none.
constexpr double kFadeBegins = 0.7, kFadeEnds = 1.2;

// On which side of a collider a sample is: n . N, of the collider and of the skin.
constexpr double kIntoSkin = -0.3;   ///< below, a surface presses on the skin from outside
constexpr double kFromWithin = 0.5;  ///< above, from within the body
constexpr double kTurnsOver = 0.95;  ///< above, what touched the skin has turned over
constexpr double kSmooth = 0.9;      ///< normal . normal of two facets of a smooth surface
constexpr double kHollow = 0.1;      ///< of the margin: how far behind a plane the surface may be in a hollow

// Where skin touches skin.
constexpr double kSharpness = 2e-3;  ///< tau, of the body's size
constexpr double kCovered = 0.15;    ///< of the tissue's thickness: as near as points on a ball's side are to it
constexpr int kCovering = 8;         ///< of those at least
/// Depth in thicknesses of both sides, up to which contacts have all weight, and from which they have none.
constexpr double kOwnFadeBegins = 0.38, kOwnFadeEnds = 0.48;
/// Of the volume of a joint: with less, contacts at it have less weight, and with two thirds of it none.
constexpr double kFolded = 0.4;
constexpr double kOwnApart = 3e-3;  ///< of the size: what a contact moves both sides apart in a step, at most

// How a reduced model gives way by patches.
constexpr double kTurned = 0.1;    ///< of the size: as far as a normal at a right angle is unlike
constexpr double kPatchReach = 2;  ///< of the distance within which half of the other places have a center
/// Own motion below which a push may do nothing, and from which all. Between, coordinates and patches do not agree
/// about what a push does: with .5 and .9, a limb on a floor was 100 % off, with these 25 %; below .6 a dog's firm head
/// throws its body.
constexpr double kOwnMotion = 0.6, kAllOwnMotion = 0.65;

}  // namespace dynamorph
