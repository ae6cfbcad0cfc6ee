# SPDX-License-Identifier: GPL-3.0-or-later
"""What a hand on the skin costs a step, for collision.py.

    python evidence/collision_grab.py ASSET FOLDER full|reduced

FOLDER gets e.g. grab_full.json. The character stands still. Three ways take turns, frame by frame, in one run: no hand
at all, a hand that holds nothing, and one that holds the softest place of the skin where it is.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from collision_fold import built  # isort: skip  (it sets up what is imported next)
import characters
import dynamic_morph_targets
import numpy as np
from contact_sheet import quiet
from dynamic_morph_targets.core.motion.grab import FIRM, Grab, pinch
from dynamic_morph_targets.core.motion.player import Player
from dynamic_morph_targets.core.settings import SimulationSettings
from dynamic_morph_targets.run.tools.grabbing import RADIUS

ROUNDS, SUBSTEPS, FPS = 40, 5, 24.0
WAYS = ("none", "idle", "holds")


def main() -> int:
    asset, folder, quality = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
    folder.mkdir(parents=True, exist_ok=True)
    dynamic_morph_targets.register()
    with quiet():
        characters.open_file(asset)
        body = characters.largest_skinned()
        characters.armature_of(body).animation_data_clear()
        model, character, rig = built(body, quality, 2, SUBSTEPS)
    player = Player(model, character, SimulationSettings(1, 2, FPS, SUBSTEPS))
    player.begin(rig)
    hand, grab, seconds = player.hand, held(player, rig), {way: [] for way in WAYS}
    for turn in range(ROUNDS * len(WAYS)):
        way = WAYS[turn % len(WAYS)]
        player.hand = None if way == "none" else hand
        hand.pull((grab,) if way == "holds" else ())
        for _ in range(2):  # the first one takes hold or lets go
            frame = player.advance(rig[1:], 2)
        seconds[way].append(frame.steps.seconds / SUBSTEPS)
    found = {way: 1e6 * float(np.median(taken)) for way, taken in seconds.items()}
    (folder / f"grab_{quality}.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


def held(player: Player, rig) -> Grab:
    """Of the place that bones hold least."""
    model = player.model
    points = player.posing.skinned(rig[:1])[0]
    moves = (model.free[model.embedding_nodes] * model.embedding_weights).sum(axis=1)
    if len(model.hold):
        moves = moves * (1.0 - (model.hold[model.embedding_nodes] * model.embedding_weights).sum(axis=1))
    radius = RADIUS * player.size
    vertices, share = pinch(points, points[moves.argmax()], radius, moves > 0.5)
    _, shear = player.character.material(0).lame()
    return Grab(vertices, points[vertices], FIRM * shear * radius * share)


if __name__ == "__main__":
    sys.exit(main())
