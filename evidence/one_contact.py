# SPDX-License-Identifier: GPL-3.0-or-later
"""`make one-contact`: the table of docs/decisions/0010: what skin would be to skin if it were found as a mesh from
outside is.

    python evidence/one_contact.py

Two characters press on each other as in collision_pair.py: coupled, and each against the skin that the bones give the
other one, as a collider. Then one folds up as in collision_fold.py, and the sign of the nearest triangle of the other
limb is compared with the winding number.
"""

from __future__ import annotations

import sys
from functools import partial

from project import ROOT

from collision_fold import CREASE, FOLDS, RATE, STILL, Inside, built, fold, nearest, simulated  # isort: skip  (it sets up what is imported next)
import characters
import collision_pair
import dynamic_morph_targets
import numpy as np
from assets import ASSETS
from collision_pair import COMES, STANDS
from contact_sheet import quiet
from dynamic_morph_targets.core.engine import dynamorph
from dynamic_morph_targets.core.motion import simulate
from dynamic_morph_targets.core.motion.player import STEP
from dynamic_morph_targets.core.settings import SimulationSettings
from mathutils import Vector
from mathutils.bvhtree import BVHTree
from measures import winding_numbers
from performance_page import grid

PAGE = ROOT / "docs/decisions/0010-two-searches-of-contact.md"
PAIR = (ASSETS / "mh_chubby_53bones.blend", ASSETS / "mh_male_53bones.blend")
MARK = "<!-- What follows is written by evidence/one_contact.py. -->\n"


def main() -> int:
    dynamic_morph_targets.register()
    with quiet():
        text = f"{pairs()}\n\n{signs()}\n"
    kept = PAGE.read_text(encoding="utf-8").partition(MARK)[0]
    PAGE.write_text(kept + MARK + "\n" + text, encoding="utf-8")
    print(text)
    return 0


def pairs() -> str:
    rows = []
    for quality in ("full", "reduced"):
        characters.open_file(PAIR[0])
        bodies = [characters.largest_skinned(), collision_pair.appended(PAIR[1])]
        collision_pair.meet(*bodies)
        made = [built(body, quality, 1 + COMES + STANDS) for body in bodies]
        settings = SimulationSettings(1, 1 + COMES + STANDS, RATE, 1, collision=True)
        for way, played in (
            ("balls", collision_pair.shots(made, settings, True)),
            ("mesh", against_meshes(made, settings)),
        ):
            rows.append([f"{quality.title()}, {way}", *figures(made, played)])
    return grid(["", "inside", "deepest, %", "apart, mm", "step, ms"], rows)


def against_meshes(made, settings) -> list[simulate.Shot]:
    """Each body alone, with a collider that is the skin of the other one as its bones pose it."""
    played = [simulate.Shot(model, character, settings) for model, character, _ in made]
    skins = [posed(shot.player, rig) for shot, (*_, rig) in zip(played, made, strict=True)]
    for shot, (*_, rig), (_, other, _), skin in zip(played, made, made[::-1], skins[::-1], strict=True):
        collider = dynamorph.Collider(skin[0], other.soft_triangles)
        steps = iter([(0, 0), *((k, k + 1) for k in range(len(skin) - 1))])  # it begins with a step that stands
        shot.player.collision.motions = partial(motion, collider, skin, steps)
        shot.player.collision.names = lambda *_: ("", "")
        shot.play(rig)
    return played


def motion(collider, skin: np.ndarray, steps, _rig) -> list:
    return [dynamorph.ColliderMotion(collider, skin[list(next(steps))], 0.0)]


def posed(player, rig) -> np.ndarray:
    """The skin (F, V, 3) where bones alone put it, world space."""
    still = np.zeros((len(player.character.vertices), 3))
    return np.array([player.posing.skin.posed(transform, still) for transform in player.posing.frames(rig)])


def figures(made, played) -> list[str]:
    skins = [collision_pair.skin_of(shot, rig) for shot, (*_, rig) in zip(played, made, strict=True)]
    found = collision_pair.inside(made, skins)
    bare = [posed(shot.player, rig)[-1] for shot, (*_, rig) in zip(played, made, strict=True)]
    apart = []
    for side in (0, 1):
        own, skin, other_bare, other = bare[side], skins[side], bare[1 - side], skins[1 - side]
        character = made[1 - side][1]
        depth = -dynamorph.Collider(other_bare, character.soft_triangles).signed_distances(own)
        pressed = depth > 0.5 * depth.max()
        tree = BVHTree.FromPolygons(other.tolist(), character.soft_triangles.tolist())
        apart += [tree.find_nearest(Vector(point))[3] for point in skin[pressed]]
    steps = np.concatenate([shot.kept()["steps"][1:] for shot in played])
    seconds = dict(zip(STEP, steps.T, strict=True))["seconds"]
    return [
        str(found["inside"]), f"{100 * found['deepest']:.2f}", f"{1000 * np.median(apart):.1f}",
        f"{2000 * np.median(seconds):.1f}",
    ]  # fmt: skip


def signs() -> str:
    rows = []
    for path in PAIR:
        characters.open_file(path)
        body = characters.largest_skinned()
        fold(characters.armature_of(body))
        body.dynamorph.collision.use = False
        model, character, rig = built(body, "reduced", 1 + FOLDS + STILL)
        shot, _ = simulated(model, character, rig, SimulationSettings(1, 1 + FOLDS + STILL, RATE, 1))
        rows.append([path.stem, *map(str, wrong(Inside(model, character, shot)))])
    return grid(["", "near", "inside", "outside, but inside by the mesh", "inside, but outside by it"], rows)


def wrong(limbs: Inside) -> tuple[int, ...]:
    """Of points nearer to another limb than the tissue is thick, away from the joint: how many there are, how many are
    inside it, and where the sign of the nearest triangle says otherwise.
    """
    counts = np.zeros(4, int)
    for outer in limbs.limbs:
        own = limbs.triangles[(limbs.of_vertex[limbs.triangles] == outer).any(axis=1)]
        others = np.flatnonzero(limbs.limb != outer)
        vertices = np.unique(own)
        far = nearest(limbs.rest[others], limbs.character.bind_points[vertices]) >= CREASE * limbs.thickness[others]
        tree = BVHTree.FromPolygons(limbs.skin.tolist(), own.tolist())
        found = [(point, *tree.find_nearest(Vector(limbs.places[point]))) for point in others[far]]
        near = [(point, place, normal) for point, place, normal, _, away in found if away < limbs.thickness[point]]
        points = limbs.places[[point for point, *_ in near]].reshape(-1, 3)
        by_mesh = np.array(
            [(Vector(x) - place).dot(normal) < 0.0 for x, (_, place, normal) in zip(points, near, strict=True)], bool
        )
        within = winding_numbers(points, limbs.skin, own) > 0.5
        counts += [len(near), within.sum(), (by_mesh & ~within).sum(), (within & ~by_mesh).sum()]
    return tuple(counts)


if __name__ == "__main__":
    sys.exit(main())
